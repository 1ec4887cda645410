"""Nets put together: what joins them, what surrounds them, and that execution never leaves what was searched."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.clock import thread_cpu
from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.execution.events import Answer, CommandCancelled, Outcome
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.verify.answers import answer_from_diagrams
from im_pnt_analysis.verify.problem import problem_of
from im_pnt_analysis.verify.report import Report
from im_pnt_analysis.verify.verdict import verify
from support.process import Clock, Process, hold


def test_composition_joins_callers_and_coordinators(data):
    report = verify([load_net(data / "dispatcher.yaml"), load_net(data / "coordinator.yaml")])
    assert report.ok
    assert report.place_bounds["coordinator.I.find"] == 2
    assert report.never_enabled == []
    assert any("net dispatcher waits for its reply" in text for text in report.assumptions)
    assert any("gives up request coordinator.find once more only when" in text for text in report.assumptions)


def asking(name: str, other: str) -> Net:
    return parse_net(
        f"net: {name}\nplaces: {{wanted: , done: , failed: }}\n"
        "services: {serve: {entry: wanted, done: done, failed: failed}}\n"
        f"transitions: {{ask: {{in: wanted, out: done, request: {other}.serve, on_failure: failed}}}}"
    )


def test_two_coordinators_that_wait_for_each_other_deadlock_only_together():
    caller = parse_net(
        "net: caller\nplaces: {idle: 1, off: , on: , end: }\n"
        "transitions: {go: {in: idle, out: on, symbol: go}, "
        "ask: {in: on, out: off, request: one.serve, on_failure: off}, back: {in: off, out: idle}}"
    )
    one, two = asking("one", "two"), asking("two", "one")
    assert verify([one]).ok
    assert verify([two]).ok
    report = verify([caller, one, two])
    assert report.has_deadlock
    assert report.refusals[0].sequence[-2:] == ("two.ask.start", "one.arrive.I.serve")


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


def test_a_token_on_its_way_is_seen_as_missing_where_it_goes():
    a = parse_net("net: a\nplaces: {idle: 1, sent: }\ntransitions: {go: {in: idle, out: [sent, b.p]}}")
    b = parse_net(
        "net: b\nrest: [p, q, r, s]\nplaces: {p: {remote: true}, q: , r: 1, s: }\n"
        "transitions: {early: {in: r, out: s, inhibitors: {p: 1}}, take: {in: [p, r], out: q}}"
    )
    report = verify([replace(a, rest=("sent",)), b])
    assert report.never_enabled == []
    assert report.states == 7  # the token not sent, underway or arrived, each with r or s; or taken


def test_a_service_that_is_not_offered_is_named(data):
    other = parse_net(
        "net: coordinator\nplaces: {a: , b: , c: }\nservices: {fnd: {entry: a, done: b, failed: c}}\n"
        "transitions: {t: {in: a, out: b, action: f, on_failure: c}}"
    )
    with pytest.raises(NetError, match=r"does not offer \(did you mean 'fnd'"):
        compose([load_net(data / "dispatcher.yaml"), other])


def test_tokens_from_nets_that_are_not_given_come_only_at_rest():
    net = parse_net(
        "net: n\nplaces: {idle: 1, gift: {remote: true}, busy: }\n"
        "transitions: {go: {in: idle, out: busy, symbol: go}, on: {in: busy, out: idle}, take: {in: gift, out: }}"
    )
    report = verify([net])
    assert report.ok
    assert report.place_bounds == {"idle": 1, "gift": 1, "busy": 1}
    assert report.states == 4  # idle or busy, with or without a gift
    hoarding = parse_net("net: n\nrest: [gift]\nplaces: {gift: {remote: true}}\ntransitions: {t: {in: {gift: 99}}}")
    report = verify([hoarding])
    assert report.bounded is False
    assert report.refusals[0].repeat == ("arrive.gift",)


CALLER = """
net: caller
places: {idle: 1, ready: , left: , done: , trouble: , lost: , gone: , sent: , back: {remote: true}}
transitions:
  begin: {in: idle, out: [ready, left], symbol: work, action: prepare, on_failure: [gone]}
  ask: {in: ready, out: done, request: server.serve, on_failure: trouble, timeout: 2.0}
  ask_too: {in: left, out: sent, request: server.other, on_failure: sent}
  again: {in: trouble, out: ready}
  send: {in: [done, sent], out: server.gift}
  home: {in: back, out: idle, emit: work_done}
  away: {in: gone, out: idle, emit: work_failed}
"""
SERVER = """
net: server
places: {wanted: , good: , bad: , asked: , fine: , poor: , gift: {remote: true}}
services:
  serve: {entry: wanted, done: good, failed: bad}
  other: {entry: asked, done: fine, failed: poor}
transitions:
  serve: {in: wanted, out: good, action: serve, on_failure: bad, timeout: 3.0}
  other: {in: asked, out: fine, action: serve, on_failure: poor}
  thank: {in: gift, out: caller.back}
"""


def test_waiting_and_being_stuck_are_told_apart_in_diagrams_too(data):
    loaded = [load_net(data / "dispatcher.yaml"), load_net(data / "coordinator.yaml")]
    caller = parse_net(
        "net: caller\nplaces: {idle: 1, off: , on: , end: }\n"
        "transitions: {go: {in: idle, out: on, symbol: go}, "
        "ask: {in: on, out: off, request: one.serve, on_failure: off}, back: {in: off, out: idle}}"
    )
    away = parse_net(
        "net: n\nplaces: {idle: 1, wait: }\n"
        "transitions: {go: {in: idle, out: wait, symbol: go}, on: {in: wait, out: idle, symbol: on}}"
    )
    ends = parse_net("net: n\nrest: [b]\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b}}")
    for nets in (loaded, [caller, asking("one", "two"), asking("two", "one")], [away], [ends]):
        problem = problem_of(nets)
        listed, counted = verify(nets), Report([])
        answer_from_diagrams(counted, problem, "", thread_cpu() + 600.0)
        for answer in ("states", "labelled_arcs", "has_deadlock", "deadlock_states", "place_bounds", "reversible"):
            assert getattr(counted, answer) == getattr(listed, answer), answer
        found = [(r.kind, len(r.sequence), r.marking.keys() <= set(problem.compiled.places)) for r in counted.refusals]
        assert found == [(r.kind, len(r.sequence), True) for r in listed.refusals]


class Watch:
    """Notes the marking of all nets together before anything happens in one."""

    def __init__(self) -> None:
        self.process: Process | None = None
        self.seen: list[frozenset[tuple[str, int]]] = []

    def __call__(self, _: object) -> None:
        """Notes what is marked."""
        if self.process is not None:
            nets = self.process.exchange.nets
            marked = {f"{name}.{place}": n for name, net in nets.items() for place, n in net.marking().items()}
            self.seen.append(frozenset(marked.items()))


TAPED = """
net: server
places: {idle: 1, bad: , good: , asked: , fine: , poor: , gift: {remote: true}}
services:
  other: {entry: asked, done: fine, failed: poor}
transitions:
  take: {in: idle, out: good, symbol: serve, action: serve, on_failure: bad}
  tell: {in: good, out: idle, emit: serve_done}
  confess: {in: bad, out: idle, emit: serve_failed}
  other: {in: asked, out: fine, action: serve, on_failure: poor}
  thank: {in: gift, out: caller.back}
"""


def searched_markings(server: str) -> set[frozenset[tuple[str, int]]]:
    nets = [parse_net(CALLER), parse_net(server)]
    problem = problem_of(nets)
    search = Search(problem.compiled, problem.initial)
    assert search.run(SearchLimits(states=1_000_000), thread_cpu() + 600.0) == ""
    own = {
        f"{name}.{place}"
        for name, executor in Process(nets, {"prepare": hold, "serve": hold}).exchange.nets.items()
        for place in executor.net.places
    }
    markings = (search.found.marking(number) for number in range(search.found.count))
    return {frozenset((place, count) for place, count in marking.items() if place in own) for marking in markings}


@pytest.fixture(scope="module", params=[SERVER, TAPED], ids=["service", "tape"])
def reachable(request):
    return request.param, searched_markings(request.param)


@settings(max_examples=60, deadline=None)
@given(steps=st.lists(st.integers(0, 7), max_size=25))
def test_what_nets_do_when_they_run_is_in_their_composition(reachable, steps):
    server, markings = reachable
    watch = Watch()
    nets = [parse_net(CALLER), parse_net(server)]
    process = Process(nets, {"prepare": hold, "serve": hold}, clock=Clock(), record=watch)
    watch.process = process
    process.pump()
    for step in steps:
        if step == 0:
            process.command("caller", "work")
        elif step == 1:
            process.exchange.nets["caller"].post(CommandCancelled(None, ImError("enough", code="cancelled")))
            process.pump()
        elif step == 2:
            process.wait(2.5)
        elif step == 3:
            process.answers["serve"] = Answer(Outcome.UNKNOWN)
        elif process.held:
            transition = process.held[step % len(process.held)][1].transition
            process.end(transition, ImError("no", code="no") if step == 7 else None)
    for marking in watch.seen:
        assert marking in markings


def test_a_command_on_the_tape_of_another_net_is_acknowledged():
    caller, server = parse_net(CALLER), parse_net(TAPED)
    assert verify([caller, server]).ok
    silent = parse_net(TAPED.replace(", emit: serve_failed", ""))
    report = verify([caller, silent])
    assert not report.ok
    assert "server.confess" in report.refusals[0].sequence
    with pytest.raises(NetError, match=r"which net server does not offer \(did you mean 'serve'"):
        verify([parse_net(CALLER.replace("server.serve", "server.served")), server])


SERVER = (
    "net: server\nplaces: {asked: , done: , failed: }\n"
    "services: {look: {entry: asked, done: done, failed: failed, arguments: {camera: {type: string}, "
    "tries: {type: integer, default: 1}}}}\ntransitions: {look: {in: asked, out: done}}"
)


@pytest.mark.parametrize(
    ("request_text", "complaint"),
    [
        ("{to: server.look, arguments: {camera: wall}}", ""),
        ("server.look", r"server.look, to which the arguments of go are passed on, has no argument 'eye'"),
        ("{to: server.look, arguments: {tries: 2}, build: rest}", ""),
        ("{to: server.look, arguments: {camra: wall}}", r"server.look has no argument 'camra' \(did you mean 'camera'"),
        ("{to: server.look, arguments: {camra: wall}, build: rest}", "has no argument 'camra'"),
        ("{to: server.look, arguments: {tries: 2}}", "server.look: argument camera is missing, a text"),
        ("{to: server.look, arguments: {camera: 3}}", "argument camera is 3, not a text"),
        ('{to: server.look, arguments: {camera: "${arguments.eye}", tries: "${arguments.n + 1}"}}', ""),
        (
            '{to: server.look, arguments: {camera: "${arguments.n}"}}',
            "argument camera: .* is a whole number, not a text",
        ),
        ('{to: server.look, arguments: {tries: "${arguments.n}"}}', "argument camera is missing"),
        ("{to: server.look, arguments: {tries: x}, build: rest}", "argument tries is 'x', not a whole number"),
    ],
)
def test_a_request_that_does_not_fit_is_refused_before_it_runs(request_text, complaint):
    caller = parse_net(
        "net: caller\ncommands: {go: {arguments: {eye: {type: string}, n: {type: integer}}}}\n"
        "places: {idle: 1}\ntransitions:\n"
        f"  ask: {{symbol: go, in: idle, out: idle, on_failure: idle, request: {request_text}}}",
        "caller.yaml",
    )
    if not complaint:
        assert verify([caller, parse_net(SERVER)]).ok
        return
    with pytest.raises(NetError, match=rf"caller.yaml:5: transition ask of net caller asks .*{complaint}"):
        compose([caller, parse_net(SERVER)])
