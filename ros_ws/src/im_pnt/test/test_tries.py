"""Actions that are tried several times: written out when a net is read, and verified, run and shown so."""

import pytest

from im_core.errors import DataError
from im_pnt.errors import NetFileError
from im_pnt.execution.events import CommandCancelled
from im_pnt.netfile import parse_net, yaml_text
from im_pnt_analysis import verify_to_load
from support.process import Process, hold

NET = """
net: n
places: {arm: 1, held: , missed: , tray: }
transitions:
  pick: {symbol: pick, in: arm, out: held, action: grasp, tries: 3, on_failure: missed}
  put: {in: held, out: arm, emit: pick_done}
  report: {in: missed, out: arm, emit: pick_failed}
"""


def fails_first(times):
    """An action that fails so often before it succeeds, and the transitions it was called for."""
    called = []

    def grasp(ctx):
        called.append(ctx.transition)
        if len(called) <= times:
            raise DataError(f"slipped {len(called)}")

    return grasp, called


@pytest.mark.parametrize(("failures", "success"), [(0, True), (1, True), (2, True), (3, False)])
def test_the_last_failure_alone_goes_to_on_failure(failures, success):
    grasp, called = fails_first(failures)
    process = Process([parse_net(NET)], {"grasp": grasp})
    process.command("n", "pick")
    assert process.results[0].success == success
    assert called == ["pick", "pick_2", "pick_3"][: failures + 1]
    if not success:
        assert str(process.results[0].error) == "slipped 3"


def test_what_is_cancelled_is_not_tried_again():
    process = Process([parse_net(NET)], {"grasp": hold})
    number = process.command("n", "pick")
    process.exchange.nets["n"].post(CommandCancelled(number, DataError("enough", code="cancelled")))
    process.pump()
    process.end("pick", DataError("it stopped", code="cancelled"))
    assert process.marking("n") == {"arm": 1}
    assert not process.results[0].success
    assert process.held == []


def test_the_tries_are_places_that_are_verified_and_a_net_is_read_as_it_is_shown():
    net = parse_net(NET)
    verify_to_load([net]).require_ok()
    assert [name for name in net.places if "failed" in name] == ["pick_failed_1", "pick_failed_2"]
    shown = parse_net(yaml_text(net))
    assert (shown.places.keys(), shown.transitions.keys()) == (net.places.keys(), net.transitions.keys())
    assert shown.transitions["pick_2"].retry_of == "pick"


def test_a_failure_without_on_failure_escalates_after_the_last_try():
    net = parse_net(NET.replace(", on_failure: missed", "").replace("net: n", "net: n\nescalate: missed"))
    process = Process([net], {"grasp": fails_first(3)[0]})
    process.command("n", "pick")
    assert str(process.results[0].error) == "slipped 3"


def test_the_reply_to_a_further_try_is_that_of_the_first():
    asks = NET.replace("action: grasp", "request: other.seek")
    asks = asks.replace("put: {", "put: {action: look, on_failure: missed, ")
    other = """
net: other
places: {asked: , found: , lost: }
services: {seek: {entry: asked, done: found, failed: lost}}
transitions: {seek: {in: asked, out: found, action: seek, on_failure: lost}}
"""
    replies = []
    seek, _ = fails_first(1)

    def answer(ctx):
        seek(ctx)
        ctx.result["where"] = 7

    actions = {"seek": answer, "look": lambda ctx: replies.append(dict(ctx.replies))}
    process = Process([parse_net(asks), parse_net(other)], actions)
    process.command("n", "pick")
    assert process.results[0].success
    assert replies == [{"pick": {"where": 7}}]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("tries: 3", "tries: 0", r"^net:5:\d+: transitions.pick.tries: 0 is not >= 1"),
        ("tries: 3", "tries: 101", r"^net:5:\d+: transitions.pick.tries: 101 is not <= 100"),
        ("tries: 3", "tries: often", r"^net:5:\d+: transitions.pick.tries: 'often' is not a whole number"),
        ("action: grasp, tries: 3, on_failure: missed", "tries: 3", r"^net:5:\d+: transitions.pick.tries: needs"),
        (", tray: ", ", pick_failed_2: ", r"^net:5:\d+: transitions.pick.tries: makes a place 'pick_failed_2'"),
        ("put: {", "pick_3: {", r"^net:5:\d+: transitions.pick.tries: makes a transition 'pick_3', and there is one"),
        ("put: {", "put: {retry_of: pik, ", r"transitions.put.retry_of: there is no transition 'pik'.*'pick'"),
    ],
)
def test_what_cannot_be_tried_is_named_with_its_line(old, new, said):
    with pytest.raises(NetFileError, match=said):
        parse_net(NET.replace(old, new))


def test_a_try_that_another_one_made_good_is_not_why_a_command_fails():
    judged = NET.replace("put: {in: held,", "put: {in: held, guard: good,") + (
        "  refuse: {in: held, out: missed, guard: not good}\n"
    )
    process = Process([parse_net(judged)], {"grasp": fails_first(1)[0]}, {"good": lambda ctx: False})
    process.command("n", "pick")
    assert not process.results[0].success
    assert "slipped" not in str(process.results[0].error)
    process = Process([parse_net(judged)], {"grasp": fails_first(3)[0]}, {"good": lambda ctx: False})
    process.command("n", "pick")
    assert str(process.results[0].error) == "slipped 3"
