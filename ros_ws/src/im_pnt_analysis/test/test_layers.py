"""Nets that are verified one by one: only where what one asks of another is always answered."""

import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.layers import comes_to_rest, parts
from im_pnt_analysis.verify.load import verify_to_load
from im_pnt_analysis.verify.verdict import verify

LIMITS = SearchLimits()
DOCS = Path(__file__).parents[4] / "docs/nets"

LOCK = """
net: {name}
places: {{free: 1, held: 0, take: , took: , give: , gave: , no: }}
services: {{lock: {{entry: take, done: took, failed: no}}, unlock: {{entry: give, done: gave, failed: no}}}}
rest: [free, held]
transitions:
  lock: {{in: [take, free], out: [took, held]}}
  unlock: {{in: [give, held], out: [gave, free]}}
  not_held: {{in: [give, free], out: [no, free]}}
"""
USER = """
net: {name}
places: {{idle: 1, one: , both: , half: , none: }}
transitions:
  first: {{symbol: go, in: idle, out: one, request: {first}.lock, on_failure: none}}
  second: {{in: one, out: both, request: {second}.lock, on_failure: half}}
  back: {{in: both, out: half, request: {second}.unlock, on_failure: half}}
  back_too: {{in: half, out: none, request: {first}.unlock, on_failure: none}}
  tell: {{in: none, out: idle, emit: go_done}}
"""


def names(divided):
    return [[net.name for net in part] for part in divided]


def test_nets_that_ask_in_a_circle_stay_together():
    nets = [load_net(DOCS / f"circular_wait_{name}.yaml") for name in ("arm", "camera")]
    assert names(parts(nets, LIMITS)) == [["circular_wait_arm", "circular_wait_camera"]]
    assert verify_to_load(nets).refusals


def test_locks_that_others_give_back_stay_with_their_users_and_their_deadlock_is_found():
    locks = [parse_net(LOCK.format(name=name)) for name in ("left", "right")]
    users = [
        parse_net(USER.format(name=name, first=first, second=second))
        for name, first, second in (("a", "left", "right"), ("b", "right", "left"))
    ]
    assert not comes_to_rest(locks[0], LIMITS)
    assert names(parts([*locks, *users], LIMITS)) == [["left", "right", "a", "b"]]
    assert verify_to_load([*locks, *users]).refusals


def test_who_sends_tokens_stays_with_who_gets_them():
    sender = parse_net("net: s\nplaces: {idle: 1}\ntransitions: {go: {symbol: go, in: idle, out: [idle, r.in]}}")
    getter = parse_net("net: r\nplaces: {in: {remote: true}}\ntransitions: {eat: {in: in}}")
    assert names(parts([sender, getter], LIMITS)) == [["s", "r"]]


def test_a_symbol_that_is_read_away_from_rest_only_keeps_nets_together():
    server = parse_net(
        """
net: server
places: {off: 1, on: }
transitions:
  start: {symbol: start, in: off, out: on, emit: start_done}
  stop: {symbol: stop, in: on, out: off, emit: stop_done}
"""
    )
    client = parse_net(
        """
net: client
places: {idle: 1, failed: }
transitions:
  ask: {symbol: go, in: idle, out: idle, request: server.start, emit: go_done, on_failure: failed}
  tell: {in: failed, out: idle, emit: go_failed}
"""
    )
    assert names(parts([client, server], LIMITS)) == [["client", "server"]]


@pytest.mark.parametrize("service", ["by service", "by symbol"])
def test_who_asks_what_is_always_answered_is_verified_alone(service):
    server = SERVERS[service]
    client = parse_net(CLIENT)
    assert names(parts([client, parse_net(server)], LIMITS)) == [["client"], ["server"]]
    report = verify_to_load([client, parse_net(server)])
    report.require_ok()
    assert report.nets == ["client", "server"]
    assert verify([client, parse_net(server)]).ok


CLIENT = """
net: client
places: {idle: 1, failed: }
transitions:
  ask: {symbol: go, in: idle, out: idle, request: server.work, emit: go_done, on_failure: failed}
  tell: {in: failed, out: idle, emit: go_failed}
"""
SERVERS = {
    "by service": """
net: server
places: {asked: , done: , failed: , tool: 1}
services: {work: {entry: asked, done: done, failed: failed}}
transitions: {work: {in: [asked, tool], out: [done, tool], action: f, on_failure: [failed, tool]}}
""",
    "by symbol": """
net: server
places: {tool: 1, done: , failed: }
transitions:
  work: {symbol: work, in: tool, out: done, action: f, on_failure: failed}
  tell: {in: done, out: tool, emit: work_done}
  tell_failed: {in: failed, out: tool, emit: work_failed}
""",
}


def some_nets(dice):
    """Nets in layers: each asks some of those below it, does it once or in two steps, and may forget to come back."""
    nets, offered = [], []
    for number in range(dice.randint(2, 4)):
        name = f"n{number}"
        steps = dice.randint(1, 2)
        forgets = dice.random() < 0.15
        places = ["tool: 1", "asked: ", "done: ", "failed: ", *(f"s{step}: " for step in range(steps))]
        transitions = ["begin: {in: [asked, tool], out: s0}"]
        for step in range(steps):
            last = step == steps - 1
            out = "[done]" if last and forgets else "[done, tool]" if last else f"[s{step + 1}]"
            act = f"request: {dice.choice(offered)}.work" if offered and dice.random() < 0.8 else "action: f"
            transitions.append(f"t{step}: {{in: s{step}, out: {out}, {act}, on_failure: [failed, tool]}}")
        text = f"net: {name}\nplaces: {{{', '.join(places)}}}\n"
        text += "services: {work: {entry: asked, done: done, failed: failed}}\n"
        if dice.random() < 0.3:
            text += f"assume: {{work: {{at_most: {dice.randint(1, 2)}}}}}\n"
        text += "transitions:\n  "
        nets.append(parse_net(text + "\n  ".join(transitions)))
        offered.append(name)
    return nets


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32))
def test_the_verdict_on_parts_is_that_on_the_whole(seed):
    nets = some_nets(random.Random(seed))
    divided = parts(nets, LIMITS)
    if all(verify(part).ok for part in divided):
        assert verify(nets).ok


def test_callers_of_whom_a_net_assumes_something_are_counted_together():
    server = parse_net(
        "net: server\nplaces: {asked: , done: , no: }\nservices: {s: {entry: asked, done: done, failed: no}}\n"
        "assume: {s: {at_most: 1}}\ntransitions: {go: {in: asked, out: done}}"
    )
    ask = (
        "places: {idle: 1}\ntransitions: {ask: {symbol: go, in: idle, out: idle, request: server.s, on_failure: idle}}"
    )
    one, other = parse_net(f"net: one\n{ask}"), parse_net(f"net: other\n{ask}")
    assert verify_to_load([server, one]).ok
    report = verify_to_load([server, one, other])
    assert "assumes at most 1 requests of s at once, and other nets bring it to 2" in report.refusals[0].reason


def test_a_tape_whose_reader_says_nothing_is_found_with_those_who_write_to_it():
    caller = parse_net(
        "net: caller\nplaces: {idle: {tokens: 2, resource: true}}\n"
        "transitions: {ask: {symbol: go, in: idle, out: idle, request: reader.serve, on_failure: idle}}"
    )
    text = "net: reader\nplaces: {free: 1}\ntransitions: {read: {symbol: serve, in: free, out: free%s}}"
    telling, silent = parse_net(text % ", emit: serve_done"), parse_net(text % "")
    assert names(parts([caller, silent], LIMITS)) == [["caller"], ["reader"]]
    assert verify_to_load([caller, telling]).ok
    assert verify_to_load([silent]).ok
    report = verify_to_load([caller, silent])
    assert report.refusals
    assert [net.name for net in report.composed] == ["reader", "caller"]
    assert report.composed[1].places["idle_ask"].tokens == 2  # as often at once as the caller can
    assert verify(report.composed).refusals[0].sequence == report.refusals[0].sequence
