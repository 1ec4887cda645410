"""Simulation: repeatable, right on the average, and honest about what is not enabled."""

import json
import math
import os
import random
import subprocess
import sys
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.model.action import FunctionAction, RequestAction
from im_pnt.model.delay import Delay, exponential
from im_pnt.model.net import Net, Place, Service, Strategy, Transition
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.simulation.replay import FiringSequence, read_firing_sequence, replay
from im_pnt_analysis.simulation.simulate import simulate, summarise
from im_pnt_analysis.timed.model import timed_net
from im_pnt_analysis.timed.player import Player
from im_pnt_analysis.timed.steady import steady_state
from im_pnt_analysis.verify.verdict import verify
from support.fixtures import NETS
from support.process import Clock, Process


def t(name, inputs, outputs, delay=None, **more):
    return Transition(name, dict.fromkeys(inputs.split(), 1), dict.fromkeys(outputs.split(), 1), delay=delay, **more)


def net(name, marking, *parts):
    places = {p: Place(p) for part in parts for p in (*part.inputs, *part.outputs, *part.on_failure)}
    return Net(name, places | {p: Place(p, n) for p, n in marking.items()}, {part.name: part for part in parts})


def constant(value):
    return Delay("constant", (value,))


EXAMPLES = [
    load_net(NETS / "molloy.yaml"),
    net("mm15", {"free": 5}, t("arrive", "free", "queue", exponential(2)), t("serve", "queue", "free", exponential(3))),
    net(
        "two_machines",
        {"idle": 3},
        t("begin", "idle", "asked", exponential(1.0)),
        t("fast", "asked", "ran", weight=3.0),
        t("slow", "asked", "crept", weight=1.0),
        t("run", "ran", "idle", exponential(5.0), action=FunctionAction("f"), on_failure={"asked": 1}, success=0.8),
        t("creep", "crept", "idle", exponential(0.5)),
    ),
]


@pytest.mark.parametrize("one", EXAMPLES, ids=lambda one: one.name)
def test_averages_agree_with_the_exact_steady_state(one):
    exact = steady_state([one])
    summary = summarise([one], seed=7, until=15_000.0)
    for estimates, values in ((summary.throughput, exact.throughput), (summary.mean_tokens, exact.mean_tokens)):
        for name, value in values.items():
            sigma = estimates[name].half_width / 2.04
            assert abs(estimates[name].mean - float(value)) <= 4.0 * sigma + 1e-12


def test_constant_service_after_poisson_arrivals():
    """M/D/1: mean number in the system is r + r^2 / (2 (1 - r)) (Pollaczek, Khinchine)."""
    load = 0.6
    queue = net("md1", {}, t("arrive", "", "queue", exponential(load)), t("serve", "queue", "", constant(1.0)))
    estimate = summarise([queue], seed=3, until=40_000.0).mean_tokens["queue"]
    expected = load + load**2 / (2 * (1 - load))
    assert abs(estimate.mean - expected) < 4.0 * estimate.half_width / 2.04


def test_littles_law_on_the_path():
    """Mean tokens = rate of arrival times mean stay, with the stays measured one by one, first come first served."""
    queue = net(
        "q", {}, t("arrive", "", "queue", exponential(0.7)), t("serve", "queue", "", Delay("uniform", (0.5, 1.5)))
    )
    until, inside, stays = 5_000.0, deque(), []
    for step in simulate([queue], seed=5, steps=None, until=until):
        if step.transition == "arrive":
            inside.append(step.time)
        else:
            stays.append(step.time - inside.popleft())
    stays += [until - since for since in inside]
    player = Player(timed_net([queue]), 5)
    player.until = until
    while player.step() >= 0:
        pass
    assert player.token_time()[0] == pytest.approx(math.fsum(stays))


def test_same_seed_same_run_in_every_process(data):
    code = "import sys; from im_pnt_analysis.cli import main; main(['simulate', *sys.argv[1:]])"
    files = [str(data / name) for name in ("dispatcher.yaml", "coordinator.yaml")]
    runs = []
    for seed, hashing in (("3", "1"), ("3", "2"), ("4", "1")):
        environment = {**os.environ, "PYTHONHASHSEED": hashing, "PYTHONPATH": os.pathsep.join(sys.path)}
        done = subprocess.run(
            [sys.executable, "-c", code, *files, "--seed", seed], capture_output=True, env=environment, check=True
        )
        runs.append(done.stdout)
    assert runs[0] == runs[1] != runs[2]


def test_enabling_memory_forgets_what_was_disabled():
    """The slow one never gets its three seconds in a row; what has a token of its own does."""
    race = net(
        "race",
        {"a": 1, "own": 1},
        t("slow", "a", "won", constant(3.0)),
        t("fast", "a", "b", constant(2.0)),
        t("back", "b", "a", constant(1.0)),
        t("patient", "own", "own2", constant(10.0)),
    )
    run = list(simulate([race], steps=None, until=31.0))
    assert [step.time for step in run if step.transition == "fast"] == [2.0 + 3.0 * k for k in range(10)]
    assert [step.time for step in run if step.transition == "patient"] == [10.0]
    assert not any(step.transition == "slow" for step in run)


def test_actions_run_side_by_side_and_one_server_works_alone():
    work = t("work", "in", "out", constant(2.0), action=FunctionAction("f"), on_failure={"bad": 1})
    times = [step.time for step in simulate([net("many", {"in": 3}, work)]) if step.transition == "work.end"]
    assert times == [2.0, 2.0, 2.0]
    times = [step.time for step in simulate([net("one", {"in": 3}, t("work", "in", "out", constant(2.0)))])]
    assert times == [2.0, 4.0, 6.0]
    for action in ({}, {"action": FunctionAction("f"), "on_failure": {"bad": 1}}):
        two = net("two", {"in": 3}, t("work", "in", "out", constant(2.0), servers=2, **action))
        assert [step.time for step in simulate([two]) if step.transition in ("work", "work.end")] == [2.0, 2.0, 4.0]


def test_where_a_token_leaves_a_clock_the_time_that_began_last_is_forgotten():
    come = t("come", "c", "a", constant(0.5))
    leaves = net(
        "leaves",
        {"a": 1, "c": 1, "d": 1},
        t("t", "a", "b", constant(2.0), servers=9),
        come,
        t("go", "a d", "e", constant(1.0)),
    )
    assert [(step.time, step.transition) for step in simulate([leaves])] == [(0.5, "come"), (1.0, "go"), (2.0, "t")]


def clocks(seed):
    """A net of up to four clocks with one server or several."""
    dice = random.Random(seed)
    places = [f"p{i}" for i in range(dice.randint(2, 4))]
    lines = [f"net: n\nplaces: {{{', '.join(f'{place}: {dice.randint(0, 4)}' for place in places)}}}\ntransitions:"]
    for number in range(dice.randint(1, 4)):
        inputs = {dice.choice(places): dice.choice([1, 1, 2])}
        if dice.random() < 0.3:
            inputs[dice.choice(places)] = 1
        outputs = dict.fromkeys(dice.choices(places, k=sum(inputs.values()))[:2], 1)
        inhibitor = dice.choice(places)
        inhibitors = {inhibitor: inputs.get(inhibitor, 0) + dice.randint(1, 3)} if dice.random() < 0.3 else {}
        arcs = f"in: {inputs}, out: {outputs}, inhibitors: {inhibitors}".replace("'", "")
        delay = dice.choice([0.37, 0.71, 1.13, 1.57, 2.21, 2.93]) + 0.01 * dice.random()
        lines.append(f"  t{number}: {{{arcs}, delay: {delay:.5f}, servers: {dice.choice([1, 2, 3, 'inf'])}}}")
    return parse_net("\n".join(lines))


def test_a_net_of_clocks_is_played_as_it_is_executed():
    """Of two that are due at one instant either may go first: no such net is among these."""
    for seed in range(60):
        one = clocks(seed)
        played = list(simulate([one], steps=None, until=9.0))
        process = Process([one], clock=Clock())
        process.wait(9.0)
        assert [firing.transition for firing in process.recorder.firings] == [step.transition for step in played], seed
        assert process.marking("n") == (played[-1].marking if played else one.initial_marking())


def test_success_failures_and_the_prior_of_a_strategy():
    def share(one, name, **more):
        counts = summarise([one], seed=1, steps=20_000, **more).counts
        return counts[name]

    def action(**more):
        return t("try", "a", "a", action=FunctionAction("f"), on_failure={"a": 1}, **more)

    assert share(net("n", {"a": 1}, action()), "try.failed") == 0
    assert share(net("n", {"a": 1}, action()), "try.failed", failures=0.2) == pytest.approx(2000, rel=0.15)
    assert share(net("n", {"a": 1}, action(success=0.7)), "try.failed", failures=0.2) == pytest.approx(3000, rel=0.1)
    choice = net("n", {"a": 1}, t("x", "a", "a", strategy=Strategy(3.0, 1.0)), t("y", "a", "a", weight=0.25))
    assert share(choice, "x") == pytest.approx(15_000, rel=0.05)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 6), st.booleans())
def test_counters_agree_with_the_marking(seed, n, timed):
    """What the player thinks enabled is what the arcs say, inhibitors and weights among them."""
    parts = [
        Transition(
            f"t{i}",
            {f"p{i}": 1 + i % 2},
            {f"p{(i + 1) % n}": 1 + i % 2},
            inhibitors={f"p{(i + 2) % n}": 3} if n > 2 and i % 3 == 0 else {},
            delay=exponential(1.0 + i) if timed and i % 2 else None,
        )
        for i in range(n)
    ]
    model = timed_net([net("ring", {"p0": 4, "p1": 2}, *parts)])
    player = Player(model, seed)
    for _ in range(60):
        before = tuple(player.tokens)
        fired = player.step()
        instant = [i for i, part in enumerate(parts) if part.delay is None and model.compiled.enabled(before, i)]
        possible = instant or [i for i in range(n) if model.compiled.enabled(before, i)]
        if fired < 0:
            assert not possible
            break
        assert fired in possible
        assert tuple(player.tokens) == model.compiled.fire(before, fired)


def test_endless_firing_at_one_instant_is_an_error():
    spin = net("spin", {"a": 1, "c": 1}, t("x", "a", "b"), t("y", "b", "a"), t("z", "c", "c", constant(1.0)))
    with pytest.raises(NetError, match="no time passes any more"):
        summarise([spin], until=10.0)
    assert len(list(simulate([spin], steps=50))) == 50


@pytest.mark.parametrize("until", [0.0, -1.0, math.nan, math.inf])
def test_time_to_stop_at_must_be_one(until):
    with pytest.raises(NetError, match="a run cannot end at time"):
        list(simulate(EXAMPLES[:1], until=until))


DINERS = net(
    "diners",
    {"f1": 1, "f2": 1},
    *(
        part
        for a, b in (("1", "2"), ("2", "1"))
        for part in (
            t(f"left{a}", f"f{a}", f"has{a}"),
            t(f"right{a}", f"has{a} f{b}", f"eats{a}"),
            t(f"leave{a}", f"eats{a}", f"f{a} f{b}"),
        )
    ),
)


def test_replay_shows_each_marking_and_what_is_enabled():
    steps = list(replay([DINERS], FiringSequence(("left1", "left2"), marking={"has1": 1, "has2": 1})))
    assert [step.marking for step in steps] == [{"f1": 1, "f2": 1}, {"f2": 1, "has1": 1}, {"has1": 1, "has2": 1}]
    assert steps[1].enabled == ("right1", "left2")
    assert steps[-1].enabled == ()


def test_counterexamples_of_verification_play():
    growing = net("growing", {"a": 1}, t("go", "a", "b"), t("more", "b", "b c"), t("less", "c d", "d"))
    ask = t("ask", "a", "b", action=RequestAction("server", "work"), on_failure={"lost": 1})
    work = t("work", "wanted", "done", action=FunctionAction("f"), on_failure={"no": 1})
    places = {name: Place(name) for name in ("wanted", "done", "no")}
    server = Net("server", places, {"work": work}, {"work": Service("work", "wanted", "done", "no")})
    for nets in ([DINERS], [growing], [net("client", {"a": 1}, ask), server]):
        report = verify(nets)
        assert report.refusals
        for refusal in report.refusals:
            steps = list(replay(nets, FiringSequence(refusal.sequence, refusal.repeat, marking=refusal.marking)))
            assert len(steps) == 1 + len(refusal.sequence) + len(refusal.repeat)


@pytest.mark.parametrize(
    ("firings", "message"),
    [
        (
            FiringSequence(("left1", "right2")),
            "step 2: transition right2 is not enabled: place has2 holds 0 of the 1 tokens.*place f1 "
            "holds 0.*; enabled: right1, left2",
        ),
        (
            FiringSequence(("left1", "lefd2")),
            r"step 2: there is no transition 'lefd2' \(did you mean 'left2'\?\); enabled: right1",
        ),
        (
            FiringSequence(("left1",), marking={"has2": 1}),
            "ends in another marking than it says: has2 holds 0 and not 1",
        ),
        (FiringSequence((), nets=("other",)), "the sequence is for the nets other; diners were given"),
    ],
)
def test_replay_says_where_a_sequence_goes_wrong(firings, message):
    with pytest.raises(NetError, match=message):
        list(replay([DINERS], firings))


def test_sequences_in_their_three_forms(tmp_path):
    assert read_firing_sequence("a -> b->c").sequence == ("a", "b", "c")
    file = tmp_path / "steps.txt"
    file.write_text("# how it gets stuck\nleft1\nleft2 -> right1\n")
    assert read_firing_sequence(str(file)).sequence == ("left1", "left2", "right1")
    file.write_text(json.dumps({"nets": ["n"], "reason": "r", "sequence": ["a"], "repeat": ["b"], "marking": {"p": 2}}))
    assert read_firing_sequence(str(file)) == FiringSequence(("a",), ("b",), "r", ("n",), {"p": 2})
    file.write_text(json.dumps({"sequence": ["a", "b"], "repeat_from": 1, "marking": None}))
    assert read_firing_sequence(str(file)) == FiringSequence(("a",), ("b",))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfe\x00", "is not UTF-8 text"),
        (b"{", "firings: not JSON"),
        (b'{"repeat": []}', "'sequence' is missing"),
        (b'{"sequence": ["a"], "repeat_from": 2}', "'repeat_from' must be a position"),
        (b'{"sequence": [1]}', "'sequence' must be a list of names"),
        (b'{"sequence": [], "marking": {"p": "2"}}', "'marking' must give places"),
        (b"[" * 100_000, "values nest deeper than 40"),
    ],
)
def test_sequences_that_cannot_be_read(tmp_path, content, message):
    file = tmp_path / "firings"
    file.write_bytes(content)
    with pytest.raises(ImError, match=message):
        read_firing_sequence(str(file))
    with pytest.raises(ImError, match="cannot read the firing sequence"):
        read_firing_sequence(str(tmp_path / "nothing"))
