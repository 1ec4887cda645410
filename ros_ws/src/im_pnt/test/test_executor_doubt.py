"""Cancellation, time-outs, and actions of which nobody knows what became."""

import asyncio

import pytest

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.execution.events import Answer, CommandCancelled, Outcome, RequestArrived
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.jobs import Command, Request
from im_pnt.netfile import parse_net
from support.process import Clock, Process, hold

TIMED = """
net: n
places: {{a: 1, b: , bad: , lost: }}
transitions: {{t: {{in: a, out: b, action: f, on_failure: bad, {}}}}}
"""
COMMAND = """
net: n
places: {idle: 1, going: , gone: , bad: }
transitions:
  begin: {in: idle, out: going, symbol: go}
  t: {in: going, out: gone, action: f, on_failure: bad}
  end: {in: gone, out: idle, emit: go_done}
  fail: {in: bad, out: idle, emit: go_failed}
"""
answers: list[Answer] = []
ENOUGH = ImError("enough", code="cancelled")


def timed(more: str, **kwargs) -> Process:
    return Process([parse_net(TIMED.format(more))], {"f": hold}, clock=Clock(), **kwargs)


def test_a_time_out_brings_the_action_in_doubt_and_has_it_asked_to_end():
    process = timed("timeout: 2")
    process.pump()
    assert process.exchange.nets["n"].next_wakeup() == pytest.approx(2.0)
    process.wait(1.9)
    assert process.marking("n") == {"t.active": 1}
    process.wait(0.2)
    assert process.marking("n") == {"t.in_doubt": 1}
    assert process.held[0][2].cancelled
    assert process.recorder.names("n") == ["t+", "t?"]
    assert "waited 2 s for function f of transition t" in process.recorder.firings[-1].message


def test_what_is_in_doubt_is_asked_again_while_it_runs_and_ends_by_itself():
    process = timed("timeout: 1")
    process.wait(100.0)
    assert process.marking("n") == {"t.in_doubt": 1}
    process.end("t")
    assert process.marking("n") == {"b": 1}
    assert process.recorder.names("n") == ["t+", "t?", "t"]
    assert process.exchange.nets["n"].next_wakeup() is None


@pytest.mark.parametrize(
    ("answer", "place"),
    [
        (Answer(Outcome.DONE), "b"),
        (Answer(Outcome.FAILED, ImError("it fell")), "bad"),
        (Answer(Outcome.UNKNOWN, asked="the gripper"), "bad"),
    ],
)
def test_the_answer_decides(answer, place):
    process = timed("timeout: 1")
    process.answers["t"] = answer
    process.wait(1.0)
    assert process.marking("n") == {place: 1}
    if answer.outcome is Outcome.UNKNOWN:
        assert "the outcome of function f of transition t of net n is unknown" in process.recorder.firings[-1].message
        assert "the gripper" in process.recorder.firings[-1].message


def test_where_nobody_can_tell_the_tokens_go_to_the_on_doubt_places():
    process = timed("timeout: 1, on_doubt: lost")
    process.answers["t"] = Answer(Outcome.UNKNOWN)
    process.wait(1.0)
    assert process.marking("n") == {"lost": 1}


def test_a_completion_after_it_was_given_up_changes_nothing():
    process = timed("timeout: 1")
    process.answers["t"] = Answer(Outcome.UNKNOWN)
    process.wait(1.0)
    process.end("t")
    assert process.marking("n") == {"bad": 1}
    assert "after it had been given up" in process.recorder.troubles[0]


@pytest.mark.parametrize(
    ("ask", "place", "message"),
    [
        (lambda ctx: answers.pop(0), "b", ""),
        (lambda ctx: 1 // 0, "bad", "asking broke: function f of transition t broke: ZeroDivisionError"),
        (lambda ctx: "yes", "bad", "its function returned 'yes'"),
    ],
)
def test_an_ask_function_finds_out_and_one_that_breaks_knows_nothing(ask, place, message):
    answers[:] = [Answer(Outcome.RUNNING), Answer(Outcome.DONE)]
    process = timed("timeout: 1", asks={"f": ask})
    process.wait(5.0)
    assert process.marking("n") == {place: 1}
    assert message in process.recorder.firings[-1].message


def test_no_answer_in_time_is_no_answer():
    process = timed("timeout: 1")
    process.pump()
    process.exchange.nets["n"]._loop.actions.ask = lambda activity, answered: None
    process.wait(30.9)
    assert process.marking("n") == {"t.in_doubt": 1}
    process.wait(0.2)
    assert process.marking("n") == {"bad": 1}
    assert "no answer came in 30 s" in process.recorder.firings[-1].message


def test_an_answer_that_came_while_the_loop_stood_still_counts_though_its_time_is_over():
    process = timed("timeout: 1")
    process.pump()
    executor, asked = process.exchange.nets["n"], []
    executor._loop.actions.ask = lambda activity, answered: asked.append(answered)
    process.wait(1.1)
    process.clock.time += 60.0
    asked[-1](Answer(Outcome.DONE))
    executor.pump()
    assert process.marking("n") == {"b": 1}


def test_there_is_nothing_to_ask_about_without_an_action():
    with pytest.raises(NetError, match=r"no action function 'go' to ask about \(did you mean 'goo'"):
        Functions({"goo": hold}, asks={"go": lambda ctx: Answer(Outcome.DONE)})


def test_cancelling_is_seen_in_the_marking_until_the_action_has_ended():
    process = Process([parse_net(COMMAND)], {"f": hold})
    number = process.command("n", "go")
    process.exchange.nets["n"].post(CommandCancelled(number, ENOUGH))
    process.exchange.nets["n"].post(CommandCancelled(number, ENOUGH))
    process.pump()
    assert process.marking("n") == {"t.cancelling": 1}
    assert process.recorder.names("n") == ["begin", "t+", "t~"]
    process.end("t", ENOUGH)
    assert process.marking("n") == {"idle": 1}
    assert process.recorder.names("n")[3:] == ["t!", "fail"]
    assert process.results[0].error is ENOUGH


def test_a_cancellation_that_meets_the_result_is_not_lost():
    process = Process([parse_net(COMMAND)], {"f": hold})
    number = process.command("n", "go")
    executor = process.exchange.nets["n"]
    executor.post(CommandCancelled(number, ENOUGH))
    executor.ended(process.held[0][1], None)
    process.pump()
    assert process.recorder.names("n") == ["begin", "t+", "t~", "t", "end"]
    assert process.results[0].success


def test_a_callback_that_comes_after_the_cancellation_is_called_at_once():
    process = Process([parse_net(COMMAND)], {"f": hold})
    number = process.command("n", "go")
    process.exchange.nets["n"].post(CommandCancelled(number, ENOUGH))
    process.pump()
    told: list[str] = []
    process.held[0][2].on_cancel(lambda: told.append("accepted"))
    assert told == ["accepted"]


def test_a_cancelled_action_may_time_out():
    text = COMMAND.replace("action: f", "action: f, timeout: 1")
    process = Process([parse_net(text)], {"f": hold}, clock=Clock())
    number = process.command("n", "go")
    process.exchange.nets["n"].post(CommandCancelled(number, ENOUGH))
    process.answers["t"] = Answer(Outcome.UNKNOWN)
    process.wait(2.0)
    assert process.recorder.names("n") == ["begin", "t+", "t~", "t?", "t!", "fail"]
    assert process.results[0].error.code == "in_doubt"


@pytest.mark.parametrize("cancelled", [False, True])
def test_an_action_that_was_called_off_because_of_its_time_ends_for_that_reason(cancelled):
    """Not because it was called off, as it says itself: who reads that looks for somebody who has cancelled."""
    text = COMMAND.replace("action: f", "action: f, timeout: 2")
    process = Process([parse_net(text)], {"f": hold}, clock=Clock())
    number = process.command("n", "go")
    process.wait(3.0)
    if cancelled:
        process.exchange.nets["n"].post(CommandCancelled(number, ENOUGH))
    process.end("t", ImError("cancelled by net n", code="cancelled"))
    error = process.results[0].error
    assert (error.code, "waited 2 s for function f" in error.message) == (
        ("cancelled", False) if cancelled else ("timeout", True)
    )


def test_cancelling_everything_reaches_actions_that_no_command_asked_for():
    process = Process([parse_net(TIMED.format("priority: 0"))], {"f": hold})
    process.pump()
    process.exchange.nets["n"].post(CommandCancelled(None, ENOUGH))
    process.pump()
    assert process.marking("n") == {"t.cancelling": 1}


def test_the_request_of_another_node_is_not_cancelled_by_the_number_of_our_command():
    process = Process([parse_net(COMMAND)], {"f": hold})
    request = Request("r", "n", "go", "elsewhere", "m", "ask", Command(7, "far"), {})
    process.exchange.nets["n"].post(RequestArrived(request))
    process.exchange.nets["n"].post(CommandCancelled(7, ENOUGH))
    process.pump()
    assert process.marking("n") == {"t.active": 1}


def test_a_cancellation_that_comes_before_its_request_is_sent_reaches_the_net_that_is_asked():
    client = parse_net(
        "net: client\nplaces: {a: 1, b: , bad: }\n"
        "transitions: {ask: {in: a, out: b, request: {to: server.s, build: builds}, on_failure: bad}}"
    )
    server = parse_net(
        "net: server\nplaces: {in: , out: , bad: }\nservices: {s: {entry: in, done: out, failed: bad}}\n"
        "transitions: {work: {in: in, out: out, action: f, on_failure: bad}}"
    )
    loop = asyncio.new_event_loop()
    built = loop.create_future()

    async def builds(ctx: ActionContext) -> dict[str, object]:
        return await built

    process = Process([client, server], {"f": hold, "builds": builds}, spawn=loop.create_task)
    process.pump()
    loop.run_until_complete(asyncio.sleep(0))
    process.exchange.nets["client"].post(CommandCancelled(None, ENOUGH))
    process.pump()
    built.set_result({"x": 1})
    loop.run_until_complete(asyncio.sleep(0))
    process.pump()
    assert not process.held, "what is not wanted is not begun"
    assert process.marking("server") == {"SI": 1, "SO": 1}
    assert process.marking("client") == {"bad": 1}
    loop.close()
