"""Expected duration of a command: closed formulas, exact against simulated, what hangs on what."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.errors import NetError
from im_pnt.model.action import FunctionAction, RequestAction
from im_pnt.model.delay import Delay, exponential
from im_pnt.model.net import Guard, Net, Place, Service, Transition
from im_pnt.netfile import parse_net
from im_pnt_analysis.simulation.simulate import simulate
from im_pnt_analysis.timed.durations import expected_command
from im_pnt_analysis.timed.measurement import MeasuredFiring, compare, estimate, with_estimates


def constant(value):
    return Delay("constant", (value,))


def action(name, inputs, outputs, delay, **more):
    return t(name, inputs, outputs, delay, action=FunctionAction(name), on_failure={"failed": 1}, **more)


def t(name, inputs, outputs, delay=None, **more):
    return Transition(name, dict.fromkeys(inputs.split(), 1), dict.fromkeys(outputs.split(), 1), delay=delay, **more)


def command(*parts):
    """A net around the transitions: symbol ``job`` marks ``begin``; ``end`` and ``failed`` are answered."""
    frame = (
        t("read", "idle", "begin", symbol="job"),
        t("tell", "end", "idle", emit=("job_done",)),
        t("regret", "failed", "idle", emit=("job_failed",)),
    )
    parts = (*frame, *parts)
    places = {p: Place(p) for part in parts for p in (*part.inputs, *part.outputs)}
    return Net("net", {**places, "idle": Place("idle", 1)}, {part.name: part for part in parts})


def times(result):
    return {one.transition: one for one in result.actions}


def test_loop_of_forty_poses():
    """One thing at a time: the sum of firings times means, whatever the distribution."""
    result = expected_command(
        [
            command(
                action("init", "begin", "ready", constant(2.0)),
                action("move", "ready", "there", Delay("uniform", (1.0, 5.0))),
                action("look", "there", "seen", Delay("gamma", (2.0, 0.25))),
                t("loop_again", "seen", "ready", weight=39.0, guard=Guard("more")),
                t("loop_done", "seen", "collected", weight=1.0, guard=Guard("more", negated=True)),
                action("compute", "collected", "end", exponential(0.5)),
            )
        ],
        "job",
        runs=300,
    )
    assert result.mean == pytest.approx(2.0 + 40 * (3.0 + 0.5) + 2.0)
    assert result.half_width == 0.0
    assert result.done == pytest.approx(1.0)
    assert result.bottleneck.transition == "move"
    assert result.bottleneck.firings == pytest.approx(40.0)
    assert result.bottleneck.critical == pytest.approx(120.0)
    assert result.bottleneck.sensitivity == pytest.approx(40.0)
    assert result.quantiles[0] < result.mean < result.quantiles[2]


def forked(left, right):
    return command(
        t("fork", "begin", "l r"),
        action("left", "l", "l2", left),
        action("right", "r", "r2", right),
        t("join", "l2 r2", "end"),
    )


def test_two_exponential_actions_side_by_side():
    """Mean of a maximum: 1/a + 1/b - 1/(a + b); its derivative by 1/a is 1 - (a's share of the race)^2."""
    a, b = 2.0, 0.5
    result = expected_command([forked(exponential(a), exponential(b))], "job", runs=50)
    assert result.mean == pytest.approx(1 / a + 1 / b - 1 / (a + b))
    assert times(result)["left"].sensitivity == pytest.approx(1 - (a / (a + b)) ** 2)
    assert times(result)["right"].sensitivity == pytest.approx(1 - (b / (a + b)) ** 2)
    assert times(result)["left"].share * result.mean == pytest.approx(1 / a)
    assert result.bottleneck.transition == "right"


def test_two_constant_actions_side_by_side():
    result = expected_command([forked(constant(3.0), constant(2.0))], "job", runs=10)
    assert result.method == "simulation of 10 runs"
    assert result.mean == pytest.approx(3.0)
    assert times(result)["left"].critical == pytest.approx(3.0)
    assert times(result)["right"].critical == 0.0
    assert times(result)["right"].share == pytest.approx(2 / 3)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(0.2, 5.0), min_size=3, max_size=3), st.floats(0.3, 0.95), st.integers(0, 2**30))
def test_simulation_agrees_with_the_exact_mean(rates, success, seed):
    """The same net, once with exponential delays and once with gamma ones of shape 1, which must be simulated."""

    def net(delay):
        return command(
            t("fork", "begin", "l r"),
            action("left", "l", "l2", delay(rates[0]), success=success),
            action("right", "r", "r2", delay(rates[1])),
            action("mend", "l2 r2", "m", delay(rates[2])),
            t("again", "m", "l r", weight=1.0),
            t("enough", "m", "end", weight=2.0),
            t("sorry", "failed r2", "end"),
        )

    def answered(one):
        rest = {name: part for name, part in one.transitions.items() if name != "regret"}
        tell = t("regret", "never", "idle", emit=("job_failed",))
        return Net("net", {**one.places, "never": Place("never")}, {**rest, "regret": tell})

    exact = expected_command([answered(net(exponential))], "job", runs=2)
    played = expected_command(
        [answered(net(lambda rate: Delay("gamma", (1.0, 1.0 / rate))))], "job", seed=seed, runs=1500
    )
    assert "exact" in exact.method
    assert "simulation" in played.method
    sigma = played.half_width / 1.96
    assert abs(played.mean - exact.mean) < 4.5 * sigma
    assert sum(one.critical for one in exact.actions) == pytest.approx(exact.mean)
    assert sum(one.critical for one in played.actions) == pytest.approx(played.mean)
    for name, one in times(exact).items():
        assert times(played)[name].firings == pytest.approx(one.firings, rel=0.3, abs=0.1)
        assert times(played)[name].critical == pytest.approx(one.critical, rel=0.3, abs=0.1 * exact.mean)


def test_sensitivity_is_the_derivative():
    def mean(m):
        one = forked(exponential(1 / m), exponential(0.7))
        return expected_command([one], "job", runs=2)

    h = 1e-5
    slope = (mean(0.9 + h).mean - mean(0.9 - h).mean) / (2 * h)
    assert times(mean(0.9))["left"].sensitivity == pytest.approx(slope, rel=1e-5)


def coordinated(success, delay):
    """A command that has its work done by another net, and looks once more when it fails."""
    main = command(
        t("ask", "begin", "end", action=RequestAction("server", "work"), on_failure={"missed": 1}, delay=constant(1e6)),
        t("ask_again", "missed", "end", action=RequestAction("server", "work"), on_failure={"failed": 1}),
    )
    work = t("work", "wanted", "ready", delay, action=FunctionAction("f"), on_failure={"no": 1}, success=success)
    places = {name: Place(name) for name in ("wanted", "ready", "no")}
    return [main, Net("server", places, {"work": work}, {"work": Service("work", "wanted", "ready", "no")})]


def test_request_takes_the_time_of_its_server_and_its_outcome():
    result = expected_command(coordinated(0.75, constant(4.0)), "job", runs=50)
    assert result.mean == pytest.approx(4.0 * 1.25)
    assert result.done == pytest.approx(1 - 0.25**2)
    assert times(result)["net.ask"].mean == pytest.approx(4.0)
    assert times(result)["net.ask"].critical == 0.0
    assert result.bottleneck.transition == "server.work"
    assert any("not its own delay" in text for text in result.assumptions)


def test_nobody_cancels():
    result = expected_command(
        [
            command(
                action("work", "begin", "half", constant(1.0)),
                t("stop", "half", "failed", guard=Guard("cancelled")),
                t("go_on", "half", "end", guard=Guard("cancelled", negated=True)),
            )
        ],
        "job",
        runs=10,
    )
    assert result.done == 1.0
    assert "nobody cancels" in result.assumptions


@pytest.mark.parametrize(
    ("parts", "symbol", "message"),
    [
        ((action("work", "begin", "end", constant(1.0)),), "jop", r"reads the symbol 'jop' \(did you mean 'job'\?\)"),
        ((action("work", "begin", "end", None),), "job", "command job fires no transition with a delay"),
        ((action("work", "begin", "nowhere", constant(1.0)),), "job", "comes to a stop .*nowhere=1"),
        (
            (t("late", "gate", "idle", exponential(1.0)), t("seize", "idle", "gate", priority=1)),
            "job",
            r"goes round for ever without an answer after \(nothing\)",
        ),
        (
            (action("work", "begin", "again", exponential(1.0)), t("back", "again", "begin", exponential(1.0))),
            "job",
            "goes round for ever without an answer",
        ),
    ],
)
def test_commands_without_an_answer_say_why(parts, symbol, message):
    with pytest.raises(NetError, match=message):
        expected_command([command(*parts)], symbol, runs=2)


def test_command_whose_answer_is_never_given():
    silent = Net("net", {"a": Place("a", 1)}, {"read": t("read", "a", "a", symbol="job")})
    with pytest.raises(NetError, match="no transition of net emits job_done or job_failed"):
        expected_command([silent], "job")


def test_measured_run_fits_and_compares():
    """A model fitted to a run expects what was measured in it."""
    model = command(
        action("init", "begin", "ready", None),
        action("move", "ready", "there", None),
        action("retry", "failed", "there", None),
        t("again", "there", "ready", guard=Guard("more")),
        t("enough", "there", "end", guard=Guard("more", negated=True)),
    )
    model = Net("net", model.places, {n: part for n, part in model.transitions.items() if n != "regret"})
    moves = [3.0, 5.0, 4.0, 4.0]
    seen = [MeasuredFiring("net.init", 1.5), MeasuredFiring("net.retry", 2.0)]
    seen += [MeasuredFiring("net.move", time, failed=time == 5.0) for time in moves]
    seen += [MeasuredFiring("net.again", 0.0)] * 3 + [MeasuredFiring("net.enough", 0.0)]
    fitted = with_estimates(model, estimate([model], seen)["net"])
    assert fitted.transitions["init"].delay == constant(1.5)
    assert fitted.transitions["move"].delay.mean == pytest.approx(4.0)
    assert fitted.transitions["move"].success == 0.75
    assert (fitted.transitions["again"].weight, fitted.transitions["enough"].weight) == (3.0, 1.0)
    expected = expected_command([fitted], "job", runs=400)
    measured = 1.5 + sum(moves) + 2.0
    assert expected.mean == pytest.approx(measured)
    by_name = {"net.init": [1.5], "net.move": moves, "net.retry": [2.0], "net.other": [7.0]}
    rows = {row.transition: row for row in compare(expected, by_name)}
    assert rows["net.move"].expected_firings == pytest.approx(4.0)
    assert rows["net.move"].measured_mean == rows["net.move"].expected_mean == pytest.approx(4.0)
    assert (rows["net.other"].expected_firings, rows["net.other"].measured_firings) == (0.0, 1)


CALLER = """
net: caller
places: {idle: 1, bad: }
transitions:
  ask: {symbol: job, in: idle, out: idle, request: worker.pick, on_failure: bad, emit: job_done}
  lost: {in: bad, out: idle, emit: job_failed}
"""
AT_ONCE = """
net: worker
places: {idle: 1, bad: }
transitions:
  go: {symbol: pick, in: idle, out: idle, action: f, delay: 2.0, success: SUCCESS, on_failure: bad, emit: pick_done}
  lost: {in: bad, out: idle, emit: pick_failed}
"""
IN_STEPS = """
net: worker
places: {idle: 1, mid: , ok: , bad: }
transitions:
  read: {symbol: pick, in: idle, out: mid}
  go: {in: mid, out: ok, action: f, delay: 2.0, success: SUCCESS, on_failure: bad}
  tell: {in: ok, out: idle, emit: pick_done}
  lost: {in: bad, out: idle, emit: pick_failed}
"""


@pytest.mark.parametrize("success", [1.0, 0.75])
@pytest.mark.parametrize("worker", [AT_ONCE, IN_STEPS])
def test_a_command_that_another_net_asks_for_takes_its_time_and_its_outcome(worker, success):
    nets = [parse_net(text.replace("SUCCESS", str(success))) for text in (CALLER, worker)]
    result = expected_command(nets, "job")
    assert result.mean == pytest.approx(2.0)
    assert result.done == pytest.approx(success)
    runs = list(simulate(nets, seed=1, steps=3000))
    assert min(count for firing in runs for count in firing.marking.values()) >= 1
    ends = [firing.transition for firing in runs if firing.transition in ("caller.ask.end", "caller.ask.failed")]
    assert ends.count("caller.ask.end") / len(ends) == pytest.approx(success, abs=0.1)
