import re

import pytest

from im_pnt.errors import VerificationError
from im_pnt.model.net import Net, Place, Transition
from im_pnt.netfile import parse_net
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.verdict import verify


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


def test_what_was_not_decided_is_not_accepted_and_said():
    text = "places: {a: 900, b: }\ntransitions: {t: {in: a, out: b}, u: {in: b, out: a}}"
    rings = [parse_net(f"net: n{i}\n{text}") for i in (1, 2)]
    report = verify(rings, SearchLimits(states=1, seconds=0.0))
    assert not report.ok
    assert not report.refusals
    with pytest.raises(VerificationError, match=r"n1\+n2 is not proved: .*resources always come back: .+--unproved"):
        report.require_ok()


@pytest.mark.parametrize(
    ("text", "reason", "sequence"),
    [
        (
            "places: {tool: 1, at_work: , idle: 1, broken: , parts: 1}\n"
            "transitions: {take: {in: [tool, idle], out: at_work}, put: {in: at_work, out: [tool, idle]}, "
            "lose: {in: at_work, out: [broken, idle]}, work: {in: [idle, parts], out: [idle, parts]}}",
            "place tool never has its token back",
            ("take", "lose"),
        ),
        (
            "places: {pool: 3, used: , run: 1}\n"
            "transitions: {use: {in: pool, out: used}, back: {in: used, out: pool}, on: {in: run, out: run}, "
            "eat: {in: {used: 3}, out: {pool: 2}}}",
            "place pool never has its 3 tokens back",
            ("use", "use", "use", "eat"),
        ),
    ],
)
def test_a_resource_that_may_be_held_for_ever_is_named_with_the_way_there(text, reason, sequence):
    report = verify([parse_net("net: n\n" + text)])
    assert report.has_deadlock is False
    assert report.resources_return is False
    assert [reason in refusal.reason for refusal in report.refusals].count(True) == 1
    assert report.refusals[0].sequence == sequence


def test_a_net_that_declares_its_rest_may_keep_what_it_holds_there():
    text = "net: n\nrest: [tool, kept]\nplaces: {tool: 1, kept: }\ntransitions: {keep: {in: tool, out: kept}}"
    assert verify([parse_net(text)]).ok
    with_symbol = parse_net(text.replace("out: kept", "out: kept, symbol: keep"))
    assert [refusal.sequence for refusal in verify([with_symbol]).refusals] == [("keep",)]


def test_a_deadlock_is_explained_by_the_siphon_that_was_emptied():
    text = (
        "net: n\nplaces: {a: 1, b: 1, x: , y: }\n"
        "transitions: {t: {in: a, out: x}, u: {in: [x, b], out: [a, b]}, "
        "v: {in: b, out: y}, w: {in: [y, a], out: [a, b]}}"
    )
    net = parse_net(text)
    refusal = verify([net]).refusals[0]
    assert refusal.marking == {"x": 1, "y": 1}
    named = set(re.search("siphon {(.+)} was emptied", refusal.reason)[1].split(", "))
    assert named <= {"a", "b"}
    for transition in net.transitions.values():
        assert not named & transition.outputs.keys() or named & transition.inputs.keys()
