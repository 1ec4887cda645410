"""What goes before what: immediate before timed, and priority among those that contend."""

from collections import deque

from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.clock import thread_cpu
from im_core.errors import ImError
from im_pnt.model.action import FunctionAction
from im_pnt.model.delay import Delay
from im_pnt.model.net import Net, Place, Transition
from im_pnt.netfile import parse_net
from im_pnt_analysis.cli import main
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.simulation.replay import FiringSequence, replay
from im_pnt_analysis.verify.problem import problem_of
from im_pnt_analysis.verify.report import readable
from im_pnt_analysis.verify.verdict import verify
from support.process import Clock, Process, hold

QUEUE = """
net: queue
places: {gate: {tokens: 1, title: the gate}, q: }
transitions:
  arrive: {in: gate, out: [gate, q], delay: {exponential: {rate: 2.0}}}
  serve: {in: q%s}
"""


def test_an_immediate_transition_goes_before_every_timed_one():
    report = verify([parse_net(QUEUE % "")])
    assert report.ok
    assert report.place_bounds == {"gate": 1, "q": 1}
    assert any("immediate before timed" in text for text in report.assumptions)
    timed = verify([parse_net(QUEUE % ", delay: {exponential: {rate: 9.0}}")])
    assert timed.bounded is False


def test_no_precedence_is_told_where_something_else_decides_too():
    for more in ("symbol: go", "guard: open", "action: clean, on_failure: q"):
        assert verify([parse_net(QUEUE % f", {more}")]).bounded is False
    clocks = "net: n\nplaces: {a: 1, b: 1, c: , d: }\ntransitions:\n"
    clocks += "".join(f"  {name}: {{in: {name}, out: c, delay: {{constant: {{value: 1.0}}}}}}\n" for name in "ab")
    report = verify([parse_net(clocks + "  swift: {in: c, out: d}\n")])
    assert report.place_bounds["c"] == 2  # both strike at once
    alone = "net: n\nplaces: {a: 2, c: , d: }\ntransitions:\n  swift: {in: c, out: d}\n"
    alone += "  clock: {in: a, out: c, delay: 1.0%s}\n"
    bounds = [verify([parse_net(alone % servers)]).place_bounds["c"] for servers in ("", ", servers: inf")]
    assert bounds == [1, 2]  # two clocks of one transition may strike at once, too


def test_the_lower_of_two_that_contend_waits():
    net = "net: n\nplaces: {a: 1, b: }\nrest: [a, b]\ntransitions:\n  up: {in: a, out: b, priority: 1}\n"
    assert verify([parse_net(net + "  low: {in: a, out: a}")]).never_enabled == ["low"]


def test_a_counterexample_has_the_names_of_the_net():
    net = parse_net(
        "net: n\nplaces: {a: {capacity: 2}, b: 1, c: , d: }\ntransitions:\n"
        "  make: {in: b, out: [b, a], delay: {exponential: {rate: 1.0}}}\n  both: {in: [c, d], out: c}\n"
    )
    (refusal, *_) = verify([net]).refusals
    assert set(refusal.sequence + refusal.repeat) == {"make"}
    assert [step.marking for step in replay([net], FiringSequence(refusal.sequence, refusal.repeat))][
        -1
    ] == refusal.marking


def test_names_for_people_are_shown(tmp_path, capsys):
    net = parse_net(QUEUE % ", title: serve a guest")
    text = readable(verify([net]), {"gate": "the gate"})
    assert "\n  called        gate: the gate\n" in text
    file = tmp_path / "queue.yaml"
    file.write_text(QUEUE % ", title: serve a guest", encoding="utf-8")
    main(["verify", str(file)])
    assert "gate: the gate, serve: serve a guest" in capsys.readouterr().out
    main(["simulate", str(file), "--steps", "1"])
    assert "serve is called serve a guest" in capsys.readouterr().out


@st.composite
def stochastic(draw):
    """Nets with immediate and timed transitions that give no more tokens than they take."""
    place = st.sampled_from("pqr")
    places = {name: Place(name, draw(st.integers(0, 2))) for name in "pqr"}
    transitions = {}
    for number in range(draw(st.integers(2, 5))):
        taken = draw(st.lists(place, min_size=1, max_size=3))
        given_ = draw(st.lists(place, max_size=len(taken)))
        counts = [{name: arcs.count(name) for name in arcs} for arcs in (taken, given_)]
        timed = draw(st.booleans())
        transitions[f"t{number}"] = Transition(
            f"t{number}",
            *counts,
            inhibitors=draw(st.dictionaries(place, st.integers(1, 3), max_size=1)),
            delay=Delay("exponential", (1.0,)) if timed else None,
            priority=0 if timed else draw(st.integers(0, 2)),
        )
    return Net("n", places, transitions, rest=("p", "q", "r"))


def fires(net, marking, t):
    """Whether a transition fires in a marking: the definition, read off each marking."""

    def enabled(u):
        takes = all(marking[name] >= weight for name, weight in u.inputs.items())
        return takes and all(marking[name] < weight for name, weight in u.inhibitors.items())

    def before(u):
        contends = u.inputs.keys() & t.inputs.keys() and u.priority > t.priority
        return u.delay is None and (t.delay is not None or contends)

    return enabled(t) and not any(before(u) and enabled(u) for u in net.transitions.values())


@settings(max_examples=60, deadline=None)
@given(stochastic())
def test_the_markings_and_firings_are_those_of_the_definition(net):
    first = tuple(place.tokens for place in net.places.values())
    names, seen, queue, firings, fired = list(net.places), {first}, deque([first]), 0, set()
    while queue:
        marking = dict(zip(names, queue.popleft(), strict=True))
        for t in net.transitions.values():
            if fires(net, marking, t):
                firings += 1
                fired.add(t.name)
                after = tuple(marking[n] - t.inputs.get(n, 0) + t.outputs.get(n, 0) for n in names)
                if after not in seen:
                    seen.add(after)
                    queue.append(after)
    report = verify([net])
    assert (report.states, report.labelled_arcs) == (len(seen), firings)
    assert set(report.never_enabled) == net.transitions.keys() - fired


LOOP = """
net: loop
places: {idle: 1, a: , b: , bad: }
transitions:
  begin: {symbol: go, in: idle, out: a}
  work: {in: a, out: b, action: work, on_failure: bad}
  again: {in: b, out: a, %s}
  leave: {in: b, out: idle, emit: go_done}
  fail: {in: bad, out: a}
"""


def test_a_command_that_a_priority_keeps_for_ever_is_refused():
    report = verify([parse_net(LOOP % "priority: 1")])
    assert report.resources_return is False
    assert report.never_enabled == ["leave"]
    assert any("priorities (loop) count: of those that contend" in text for text in report.assumptions)


def test_a_guard_or_a_lower_rank_lets_the_command_go():
    for more in ("guard: more, priority: 1", "priority: -1", "priority: 1, symbol: {name: on, of: command}"):
        assert verify([parse_net(LOOP % more)]).ok, more


def test_a_delay_that_never_ends_before_what_needs_no_time_never_fires():
    report = verify([parse_net(LOOP % "delay: 5")])
    assert report.never_enabled == ["again"]


def test_the_first_lines_of_a_verdict_say_what_it_does_not_know():
    net = parse_net(
        """
net: n
places: {idle: 1, left: , right: , there: , bad: }
transitions:
  begin: {symbol: go, in: idle, out: [left, right]}
  ask: {in: left, out: there, await: {name: /said, type: std_msgs/msg/String}, on_failure: bad}
  wait: {in: right, out: [], delay: 2}
  both: {in: [there, right], out: [there, right], priority: 1}
  end: {in: there, out: idle, emit: go_done}
  fail: {in: bad, out: idle, emit: go_failed}
"""
    )
    lines = readable(verify([net]), {}).splitlines()
    begin = next(number for number, line in enumerate(lines) if "not looked at" in line)
    assert [" ".join(line.removeprefix("  not looked at").split()) for line in lines[begin : begin + 3]] == [
        "how long the delays of wait are (n): any may be over first",
        "whether the messages of ask (n) come: without a timeout they wait for ever",
        "what goes before what at both: it takes tokens of several commands, or has too many ways to fire",
    ]
    assert lines[begin + 3].startswith("  markings")


@st.composite
def driven(draw):
    """Nets whose commands begin actions, and contend by priority for tokens, some with a tool or a delay."""
    place, tool = st.sampled_from("abc"), st.sampled_from("xy")
    places = {name: Place(name) for name in "abcd"} | {name: Place(name, 1, resource=True) for name in "xy"}
    places["idle"] = Place("idle", 2, resource=True)
    transitions = {"begin": Transition("begin", {"idle": 1}, {draw(place): 1, draw(place): 1}, symbol="go")}
    for number in range(draw(st.integers(2, 6))):
        taken = dict.fromkeys(draw(st.lists(place, min_size=1, max_size=2)), 1)
        tools = dict.fromkeys(draw(st.lists(tool, max_size=1)), 1)
        kind = draw(st.sampled_from(("act", "clock", "move", "move")))
        act = FunctionAction("act") if kind == "act" else None
        later = "abcd"["abcd".index(max(taken)) + 1]  # what needs no time goes on for ever nowhere
        given_ = [later] if kind == "move" else draw(st.lists(place, max_size=1))
        transitions[f"t{number}"] = Transition(
            f"t{number}",
            {**taken, **tools},
            {**dict.fromkeys(given_, 1), **tools},
            action=act,
            on_failure={draw(place): 1, **tools} if act else {},
            delay=Delay("constant", (draw(st.sampled_from((1.0, 2.0))),)) if kind == "clock" else None,
            priority=draw(st.integers(0, 2)),
        )
    return Net("n", places, transitions, rest=tuple(places))


@settings(max_examples=60, deadline=None)
@given(driven(), st.randoms(use_true_random=False))
def test_what_nets_in_execution_reach_is_in_the_proof(net, dice):
    problem = problem_of([net])
    search = Search(problem.compiled, problem.initial)
    assert not search.run(SearchLimits(), thread_cpu() + 100.0)
    known = list(problem.compiled.places)
    proved = {tuple(search.found.marking(n).get(name, 0) for name in known) for n in range(search.found.count)}
    reached: set[tuple[int, ...]] = set()

    def note(_: object) -> None:
        if process is not None:
            marking = process.marking("n")
            reached.add(tuple(marking.get(name, 0) for name in known))

    process = None
    process = Process([net], {"act": hold}, clock=Clock(), record=note, seed=dice.randint(0, 1000))
    for _ in range(8):
        match dice.choice(("go", "end", "fail", "wait")):
            case "go" if process.marking("n").get("idle"):
                process.command("n", "go")
            case "end" | "fail" as step if process.held:
                error = ImError("no") if step == "fail" else None
                process.end(dice.choice(process.held)[1].transition, error)
            case _:
                process.wait(1.0)
        note(None)
    assert reached <= proved


def test_tokens_of_two_commands_put_nothing_first_in_the_proof_either():
    net = parse_net(
        """
net: n
places: {idle: 2, a: , b: , c: , z: {resource: true}}
transitions:
  one: {symbol: one, in: idle, out: a}
  two: {symbol: two, in: idle, out: [b, z]}
  both: {in: [a, b, z], out: [], priority: 1}
  low: {in: [a, z], out: c}
  end_one: {in: c, out: idle, emit: one_done, guard: ends}
  end_two: {in: [b, z], out: idle, emit: two_done, guard: ends}
"""
    )
    process = Process([net], guards={"ends": lambda ctx: False})
    process.command("n", "one")
    process.command("n", "two")
    assert process.marking("n") == {"b": 1, "c": 1}
    assert "low" not in verify([net]).never_enabled
