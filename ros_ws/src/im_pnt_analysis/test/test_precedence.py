"""What goes before what: immediate before timed, and priority among those that contend."""

from collections import deque

from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.model.delay import Delay
from im_pnt.model.net import Net, Place, Transition
from im_pnt.netfile import parse_net
from im_pnt_analysis.cli import main
from im_pnt_analysis.simulation.replay import FiringSequence, replay
from im_pnt_analysis.verify.report import readable
from im_pnt_analysis.verify.verdict import verify

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


@settings(max_examples=150, deadline=None)
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
