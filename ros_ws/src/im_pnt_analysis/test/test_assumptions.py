"""What a net assumes of its partners lets it be verified alone, and is a promise that they must keep together."""

from collections import deque
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from im_core.clock import thread_cpu
from im_pnt.errors import NetFileError
from im_pnt.model.compiled import compile_net
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.verify.problem import problem_of
from im_pnt_analysis.verify.verdict import verify

NETS = Path(__file__).resolve().parents[4] / "docs" / "nets"
PRESS, BELT = load_net(NETS / "credit_press.yaml"), load_net(NETS / "credit_belt.yaml")


def belt(transitions, places="", assumed="{}"):
    return parse_net(
        f"net: credit_belt\nplaces: {{parts: {{remote: true}}, free: 1, carrying: {places}}}\n"
        f"assume: {assumed}\ntransitions:\n  take: {{in: [parts, free], out: carrying}}\n{transitions}"
    )


def refusals(*nets):
    return [(refusal.kind, refusal.reason) for refusal in verify(nets).refusals]


def test_a_credit_and_a_window_are_verified_alone_and_together():
    alone = verify([PRESS])
    assert alone.ok
    assert alone.place_bounds["credit"] == 2
    alone = verify([BELT])
    assert alone.ok
    assert alone.place_bounds["parts"] == 2
    together = verify([PRESS, BELT])
    assert together.ok
    assert together.live
    assert not verify([replace(PRESS, assume={})]).ok
    assert verify([replace(BELT, assume={})]).place_bounds["parts"] == 1  # only while all is at rest


def test_more_than_was_assumed_is_refused_with_the_way_there():
    report = verify([load_net(NETS / "hasty_press.yaml"), BELT])
    reason = "net credit_belt assumes at most 2 tokens under way to parts or in it, and other nets bring it to 3"
    assert (report.refusals[0].kind, report.refusals[0].reason) == ("assumption", reason)
    assert report.refusals[0].sequence == ("credit_press.press", "credit_press.send") * 3


def test_a_token_that_was_not_sent_breaks_a_promise_though_nothing_else_goes_wrong():
    generous = belt(
        "  drop: {in: carrying, out: [free, credit_press.credit]}\n"
        "  gift: {symbol: gift, in: free, out: [free, credit_press.credit]}"
    )
    report = verify([PRESS, generous])
    assert report.refusals[0].kind == "assumption"
    assert report.refusals[0].sequence == ("credit_belt.gift unasked",)
    assert "credit gets back what it has sent to credit_belt.parts, and it gets a token that it has not" in (
        report.refusals[0].reason
    )


@pytest.mark.parametrize(
    "transitions",
    [
        "  drop: {in: carrying, out: [free, credit_press.credit]}\n  lose: {in: carrying, out: free}",
        "  drop: {in: carrying, out: free}",
    ],
)
def test_a_token_that_never_comes_back_breaks_a_promise(transitions):
    press = replace(PRESS, rest=("idle", "credit"))
    kind, reason = refusals(press, belt(transitions))[0]
    assert kind == "assumption"
    assert "comes back in credit, and after this it never all does" in reason


SERVER = """
net: server
places: {asked: , done: , failed: }
services: {serve: {entry: asked, done: done, failed: failed}}
assume: {serve: {at_most: 2}}
transitions: {work: {in: asked, out: done}}
"""


def caller(name):
    return parse_net(
        f"net: {name}\nplaces: {{idle: 1}}\n"
        "transitions: {go: {symbol: go, in: idle, out: idle, request: server.serve, on_failure: idle}}"
    )


def test_requests_at_once_are_assumed_alone_and_counted_together():
    alone = verify([parse_net(SERVER)])
    assert alone.ok
    assert alone.place_bounds["I.serve"] == 2
    assert verify([parse_net(SERVER), caller("a"), caller("b")]).ok
    report = verify([parse_net(SERVER), caller("a"), caller("b"), caller("c")])
    reason = "net server assumes at most 2 requests of serve at once, and other nets bring it to 3"
    assert (report.refusals[0].kind, report.refusals[0].reason) == ("assumption", reason)
    assert report.refusals[0].sequence == ("a.go.start", "b.go.start", "c.go.start")


@pytest.mark.parametrize(
    ("assumed", "says"),
    [
        ("{credit: {at_most: 1}}", "assume.credit.at_most: 1 is less than the 2 tokens that are in 'credit' at first"),
        ("{credit: {}}", "assume.credit: say either at_most or returns"),
        ("{credit: {at_most: 2, returns: belt.parts}}", "assume.credit: say either at_most or returns"),
        ("{credit: {at_most: none}}", "assume.credit.at_most: 'none' is not a whole number"),
        ("{credti: {at_most: 2}}", r"there is no remote place and no service 'credti' \(did you mean 'credit'\?\)"),
        ("{idle: {at_most: 2}}", "there is no remote place and no service 'idle'"),
        ("{home: {at_most: 2}}", "transition 'send' marks 'home' too"),
        ("{credit: {returns: belt.prts}}", r"no transition sends .* 'belt.prts' \(did you mean 'belt.parts'\?\)"),
        ("{credit: {returns: belt}}", "'belt' is not of the form net.place"),
        ("{serve: {returns: belt.parts}}", "'serve' is a service, to which no token comes back"),
        ("{credit: {most: 2}}", "'most' is not a known key"),
        ("[credit]", "assume: a list is not a mapping"),
    ],
)
def test_an_assumption_that_says_nothing_is_named(assumed, says):
    text = (
        "net: press\nplaces: {idle: 1, out: , bad: , credit: {tokens: 2, remote: true}, home: {remote: true}}\n"
        f"services: {{serve: {{entry: idle, done: out, failed: bad}}}}\nassume: {assumed}\n"
        "transitions: {send: {in: [idle, credit], out: [home, belt.parts]}}"
    )
    with pytest.raises(NetFileError, match=rf"net:4:\d+: .*{says}"):
        parse_net(text)


STEPS = st.lists(
    st.tuples(
        st.dictionaries(st.sampled_from(["parts", "x", "y"]), st.integers(1, 2), min_size=1, max_size=2),
        st.dictionaries(st.sampled_from(["x", "y", "credit_press.credit"]), st.integers(1, 2), max_size=2),
    ),
    min_size=1,
    max_size=3,
)
MOST_STATES = 600


def partner(steps, most):
    lines = [f"  t{i}: {{in: {dict(inputs)}, out: {dict(outputs)}}}" for i, (inputs, outputs) in enumerate(steps)]
    return parse_net(
        f"net: credit_belt\nrest: [x, y, parts]\nplaces: {{parts: {{remote: true}}, x: 1, y: }}\n"
        f"assume: {{parts: {{at_most: {most}}}}}\ntransitions:\n" + "\n".join(lines).replace("'", "")
    )


def played(nets):
    """All that can happen without assumptions: markings with what is owed, found by firing; None if it is too much."""
    composition = compose([replace(net, assume={}) for net in nets])
    compiled = compile_net(composition.net)
    back, to = "credit_press.credit.underway", "credit_belt.parts.underway"
    index = {name: i for i, name in enumerate(compiled.places)}
    weights = [
        (t.outputs.get(to, 0) if "send" in t.name else 0, t.outputs.get(back, 0))
        for t in composition.net.transitions.values()
    ]
    first = (compiled.marking_vector(composition.net.initial_marking()), 0)
    after, waiting = {first: []}, deque([first])
    while waiting:
        here = waiting.popleft()
        vector, owed = here
        for number, (sent, returned) in enumerate(weights):
            if owed < 0 or not compiled.enabled(vector, number):
                continue
            there = compiled.fire(vector, number), owed + sent - returned
            after[here].append(there)
            if there not in after:
                after[there] = []
                waiting.append(there)
                if len(after) > MOST_STATES:
                    return None
    return after, index


def can_be_paid(after):
    """The states from which one can be reached in which nothing is owed."""
    before = {state: [] for state in after}
    for state, others in after.items():
        for other in others:
            before[other].append(state)
    found = {state for state in after if state[1] == 0}
    waiting = list(found)
    while waiting:
        for state in before[waiting.pop()]:
            if state not in found:
                found.add(state)
                waiting.append(state)
    return found


@settings(max_examples=60, deadline=None)
@given(STEPS, st.integers(1, 3))
def test_promises_are_broken_exactly_where_firing_breaks_them(steps, most):
    press, other = replace(PRESS, rest=("idle", "pressed", "credit")), partner(steps, most)
    result = played([press, other])
    assume(result is not None)
    after, index = result
    under_way, there = index.get("credit_belt.parts.underway"), index["credit_belt.parts"]
    too_many = any(vector[under_way] + vector[there] > most for vector, _ in after)
    unasked = any(owed < 0 for _, owed in after)
    unpaid = not unasked and len(can_be_paid(after)) < len(after)
    report = verify([press, other])
    broken = [refusal for refusal in report.refusals if refusal.kind == "assumption"]
    assert bool(broken) == (too_many or unasked or unpaid)
    if not (too_many or unasked):
        assert report.states == len({vector for vector, _ in after})
        own = _markings(problem_of([press, other]), "credit_press.")
        assert own <= _markings(problem_of([press]), "")


def _markings(problem, prefix):
    """What the places of the press hold in all reachable markings."""
    search = Search(problem.compiled, problem.initial)
    assert search.run(SearchLimits(states=100_000), thread_cpu() + 600.0) == ""
    markings = (search.found.marking(number) for number in range(search.found.count))
    return {tuple(marking.get(f"{prefix}{place}", 0) for place in PRESS.places) for marking in markings}
