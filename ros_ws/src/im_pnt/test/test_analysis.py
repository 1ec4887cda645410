import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.analysis.compose import compose
from im_pnt.analysis.reachability import Limits
from im_pnt.analysis.semiflows import p_semiflows, t_semiflows
from im_pnt.analysis.verify import verify
from im_pnt.compiled import compile_net
from im_pnt.errors import NetError, VerificationError
from im_pnt.net import Net, Place, Transition
from im_pnt.netfile import load_net, parse_net


def philosophers(count: int) -> Net:
    """Each takes the left fork, then the right one: 3**n states, deadlocks when all hold their left fork."""
    places, transitions = {}, {}
    for i in range(count):
        for name, tokens in ((f"fork{i}", 1), (f"think{i}", 1), (f"left{i}", 0), (f"right{i}", 0)):
            places[name] = Place(name, tokens)
        left, right = f"fork{i}", f"fork{(i + 1) % count}"
        for name, inputs, outputs in (
            (f"takeLeft{i}", (f"think{i}", left), (f"left{i}",)),
            (f"takeRight{i}", (f"left{i}", right), (f"right{i}",)),
            (f"release{i}", (f"right{i}",), (f"think{i}", left, right)),
        ):
            transitions[name] = Transition(name, dict.fromkeys(inputs, 1), dict.fromkeys(outputs, 1), origin=name)
    return Net("philosophers", places, transitions)


def test_philosophers_deadlock_with_the_shortest_sequence():
    report = verify([philosophers(4)])
    assert report.bounded
    assert report.has_deadlock
    assert len(report.refusals[0].sequence) == 4
    assert {name[:-1] for name in report.refusals[0].sequence} == {"takeLeft"}
    with pytest.raises(VerificationError, match=r"is stuck with .*; shown by firing takeLeft"):
        report.require_ok()


@pytest.mark.parametrize(
    ("text", "reason", "sequence"),
    [
        ("places: {a: 1, b: }\ntransitions: {t: {in: a, out: [a, b]}}", "place b can grow without end", ("t",)),
        (
            "places: {a: 1, b: {capacity: 1}}\ntransitions: {t: {in: a, out: {b: 2}}, u: {in: {b: 2}, out: a}}",
            "place b gets 2 tokens, more than its capacity of 1",
            ("t",),
        ),
        (
            "places: {idle: 1, tool: 1, busy: }\n"
            "transitions: {go: {in: [idle, tool], out: busy, symbol: go}, end: {in: busy, out: idle}}",
            "stuck with idle=1",
            ("go", "end"),
        ),
        (
            "places: {idle: 1, wait: }\n"
            "transitions: {go: {in: idle, out: wait, symbol: go}, on: {in: wait, out: idle, symbol: on}}",
            "waits for its tape or a caller away from rest with wait=1",
            ("go",),
        ),
        (
            "places: {idle: 1, tool: 1, busy: , broken: }\nrest: [idle, tool]\n"
            "transitions: {go: {in: [idle, tool], out: [idle, tool], symbol: go}, "
            "lose: {in: [idle, tool], out: idle, symbol: lose}, other: {in: idle, out: idle, symbol: other}}",
            "go can never fire again",
            ("lose",),
        ),
    ],
)
def test_each_kind_of_bad_net_is_refused_for_its_reason(text, reason, sequence):
    report = verify([parse_net("net: n\n" + text)])
    assert not report.ok
    assert reason in report.refusals[0].reason
    assert report.refusals[0].sequence + report.refusals[0].repeat == sequence


def test_waiting_at_a_declared_rest_is_no_deadlock():
    text = (
        "net: n\nrest: [idle, wait]\nplaces: {idle: 1, wait: }\n"
        "transitions: {go: {in: idle, out: wait, symbol: go}, on: {in: wait, out: idle, symbol: on}}"
    )
    assert verify([parse_net(text)]).ok


def test_a_search_that_does_not_end_refuses_and_says_why():
    report = verify([philosophers(6)], Limits(states=100))
    assert report.bounded
    assert report.unknown["never_enabled_transitions"] == "more than 100 markings"
    assert not report.ok


def test_composition_joins_callers_and_coordinators(data):
    nets = [load_net(data / "dispatcher.yaml"), load_net(data / "coordinator.yaml")]
    report = verify(nets)
    assert report.ok
    assert report.place_bounds["coordinator.I.find"] == 1
    assert report.never_enabled_transitions == []
    assert any("gets its reply" in text for text in report.assumptions)


def test_two_coordinators_that_wait_for_each_other_deadlock_only_together():
    def coordinator(name: str, other: str) -> Net:
        return parse_net(
            f"net: {name}\nplaces: {{wanted: , done: , failed: , asked: }}\n"
            "services: {serve: {entry: wanted, done: done, failed: failed}}\n"
            f"transitions: {{ask: {{in: wanted, out: done, request: {other}.serve, on_failure: failed}}}}"
        )

    caller = parse_net(
        "net: caller\nplaces: {idle: 1, off: , on: , end: }\n"
        "transitions: {go: {in: idle, out: on, symbol: go}, "
        "ask: {in: on, out: off, request: one.serve, on_failure: off}, back: {in: off, out: idle}}"
    )
    one, two = coordinator("one", "two"), coordinator("two", "one")
    assert verify([one]).ok
    assert verify([two]).ok
    report = verify([caller, one, two])
    assert report.has_deadlock
    assert report.refusals[0].sequence[-1] == "two.ask.start"


def test_remote_places_join_nets_and_must_be_open():
    text = "net: b\nplaces: {p: {remote: true}, q: 1}\ntransitions: {t: {in: p, out: a.back}}"
    a = parse_net(
        "net: a\nplaces: {idle: 1, back: {remote: true}}\n"
        "transitions: {go: {in: idle, out: b.p, symbol: go}, home: {in: back, out: idle}}"
    )
    assert verify([a, parse_net(text)]).ok
    with pytest.raises(NetError, match=r"b\.p, which is not open to other nets; give it 'remote: true'"):
        compose([a, parse_net(text.replace("{remote: true}", ""))])
    with pytest.raises(NetError, match=r"place that net b does not have"):
        compose([a, parse_net(text.replace("p: {", "pp: {").replace("in: p", "in: pp"))])


def test_a_service_that_is_not_offered_is_named(data):
    other = parse_net(
        "net: coordinator\nplaces: {a: , b: , c: }\nservices: {fnd: {entry: a, done: b, failed: c}}\n"
        "transitions: {t: {in: a, out: b, action: f, on_failure: c}}"
    )
    with pytest.raises(NetError, match=r"does not offer \(did you mean 'fnd'"):
        compose([load_net(data / "dispatcher.yaml"), other])


small_nets = st.integers(2, 4).flatmap(
    lambda n: st.tuples(
        st.lists(st.integers(0, 2), min_size=n, max_size=n),
        st.lists(
            st.tuples(*(st.dictionaries(st.integers(0, n - 1), st.integers(1, 2), min_size=k) for k in (1, 0, 0))),
            min_size=1,
            max_size=4,
        ),
    )
)


def built(spec) -> Net:
    tokens, rows = spec
    places = {f"p{i}": Place(f"p{i}", count) for i, count in enumerate(tokens)}

    def arcs(row):
        return {f"p{i}": weight for i, weight in row.items()}

    transitions = {
        f"t{i}": Transition(
            f"t{i}", arcs(inp), arcs(out), inhibitors={p: w + 2 for p, w in arcs(inh).items()}, origin=f"t{i}"
        )
        for i, (inp, out, inh) in enumerate(rows)
    }
    return Net("random", places, transitions)


def brute_force(net: Net, cap: int):
    """Reachable markings by the definition, with dictionaries; None when there are more than ``cap``."""
    first = tuple(place.tokens for place in net.places.values())
    names = list(net.places)
    known, stack, dead = {first}, [first], set()
    while stack:
        marking = stack.pop()
        at = dict(zip(names, marking, strict=True))
        alive = False
        for t in net.transitions.values():
            if all(at[p] >= w for p, w in t.inputs.items()) and all(at[p] < w for p, w in t.inhibitors.items()):
                alive = True
                after = tuple(at[p] - t.inputs.get(p, 0) + t.outputs.get(p, 0) for p in names)
                if after not in known:
                    known.add(after)
                    stack.append(after)
        if not alive:
            dead.add(marking)
        if len(known) > cap:
            return None
    return known, dead


@settings(max_examples=200, deadline=None)
@given(small_nets)
def test_the_search_agrees_with_the_definition(spec):
    net = built(spec)
    report = verify([net], Limits(states=400, seconds=5.0))
    reference = brute_force(net, 400)
    if report.bounded and report.states <= 400:
        known, dead = reference
        assert report.states == len(known)
        assert report.place_bounds == {f"p{i}": max(m[i] for m in known) for i in range(len(net.places))}
        assert report.has_deadlock == bool(dead)
    elif report.bounded is False:
        assert reference is None
        compiled = compile_net(net)
        marking = compiled.marking_vector(net.initial_marking())
        refusal = report.refusals[0]
        path = [compiled.transitions.index(name) for name in refusal.sequence + 3 * refusal.repeat]
        for transition in path:
            assert compiled.enabled(marking, transition)
            marking = compiled.fire(marking, transition)
        assert sum(marking) > sum(net.initial_marking().values()) or any(m > 2 for m in marking)


@settings(max_examples=100, deadline=None)
@given(small_nets)
def test_semiflows_are_invariant(spec):
    compiled = compile_net(built(spec))
    for flow in p_semiflows(compiled).flows:
        assert all(weight > 0 for weight in flow.values())
        for change in compiled.change:
            assert sum(flow.get(compiled.places[place], 0) * delta for place, delta in change) == 0
    for flow in t_semiflows(compiled).flows:
        total = [0] * len(compiled.places)
        for name, count in flow.items():
            for place, delta in compiled.change[compiled.transitions.index(name)]:
                total[place] += count * delta
        assert not any(total)
