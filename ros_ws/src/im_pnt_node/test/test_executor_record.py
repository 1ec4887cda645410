"""What a net records, done again, gives the same net: at every point of its history, and from every snapshot."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.execution.events import (
    Answer,
    CommandCancelled,
    ModeSet,
    ObjectInvalidated,
    Outcome,
    PauseSet,
    RequestArrived,
    RequestCancelled,
    TokenArrived,
)
from im_pnt.execution.firing.rule import ABANDONED_CODE
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import ActivityState, Command, Request
from im_pnt.execution.journal_entries import NetEntry, difference, renewed
from im_pnt.execution.operator import Mode
from im_pnt.netfile import parse_net
from im_pnt_node.distributed.codec import NET_ENTRY
from im_pnt_node.journal.state import net_state, restore_net
from support.process import Clock, Process, hold

NET = """
net: n
places:
  idle: 2
  tool: 1
  spare: {remote: true}
  ready:
  path: {data_object: path, on_invalid: [ready]}
  done:
  bad:
  lost:
  asked:
  answered:
  armed:
services: {serve: {entry: asked, done: answered, failed: bad}}
transitions:
  begin: {in: idle, out: [ready, armed], symbol: go}
  halt: {in: armed, out: armed, cancels: move, guard: again}
  plan: {in: ready, out: path, action: now, on_failure: bad}
  move: {in: [path, tool], out: [done, tool], action: act, on_failure: [bad, tool], on_doubt: [lost, tool], timeout: 1}
  found: {in: lost, out: bad, action: now, on_failure: bad, keeps_failure: true}
  again: {in: done, out: ready, guard: again}
  finish: {in: done, out: idle, guard: not again, emit: go_done}
  give_up: {in: [bad, idle], out: [idle, idle], emit: go_failed}
  use: {in: [spare, tool], out: tool, delay: 2}
  work: {in: asked, out: answered, action: act, on_failure: bad}
"""
STEPS = (
    "go",
    "end",
    "fail",
    "cancel",
    "abandon",
    "invalid",
    "toggle",
    "token",
    "request",
    "unwanted",
    "wait",
    "unknown",
    "mode",
    "pause",
)


def run(steps: list[str]) -> tuple[Process, list[tuple[int, dict]]]:
    """Does some steps; returns the process, and its state after each with the number of entries up to there."""
    again = [False]
    entries: list[list[object]] = []

    def now(ctx: ActionContext) -> None:
        ctx.memory["plans"] = ctx.memory.get("plans", 0) + 1
        ctx.result["last"] = (1, ctx.failure and str(ctx.failure))
        ctx.progress("planned", 0.5)

    process = Process(
        [parse_net(NET)],
        {"now": now, "act": hold},
        {"again": lambda ctx: again[0]},
        clock=Clock(),
        record=lambda entry: entries.append(NET_ENTRY.content(entry)),
    )
    executor = process.exchange.nets["n"]
    process.pump()
    states = [(0, json.loads(json.dumps(net_state(executor))))]
    numbers = [0]
    for count, step in enumerate(steps):
        match step:
            case "go":
                numbers.append(process.command("n", "go"))
            case "end" | "fail" if process.held:
                ending = next(held for held in process.held if held[1].transition == process.held[-1][1].transition)
                ending[2].memory["ended"] = ending[1].number
                process.end(process.held[-1][1].transition, ImError("no", count=count) if step == "fail" else None)
            case "cancel":
                executor.post(CommandCancelled(numbers[-1], ImError("enough", code="cancelled")))
            case "abandon":
                executor.post(CommandCancelled(numbers[-1], ImError("enough", code=ABANDONED_CODE)))
            case "invalid":
                executor.post(ObjectInvalidated(f"node/{numbers[-1]}/path"))
            case "toggle":
                again[0] = not again[0]
            case "token":
                executor.post(TokenArrived("spare", 1))
            case "request":
                executor.post(
                    RequestArrived(Request(f"r{count}", "n", "serve", "", "m", "t", Command(7, "far"), {"x": 1}))
                )
            case "unwanted":
                executor.post(RequestArrived(Request("u", "n", "serve", "", "m", "t", Command(), {})))
                executor.post(RequestCancelled("u", ImError("not wanted any more")))
            case "wait":
                process.wait(0.7)
            case "unknown":
                process.answers["move"] = Answer(Outcome.UNKNOWN)
            case "mode":
                executor.post(ModeSet(Mode.STEP if executor.operator.mode is Mode.AUTOMATIC else Mode.AUTOMATIC))
            case "pause":
                executor.post(PauseSet(not executor.paused))
        process.pump()
        states.append((len(entries), json.loads(json.dumps(net_state(executor)))))
    process.entries = entries
    return process, states


def fresh() -> Process:
    return Process([parse_net(NET)], {"now": hold, "act": hold}, {"again": lambda ctx: False}, clock=Clock())


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(STEPS), max_size=25))
def test_entries_done_again_give_the_same_state_at_every_point_and_from_every_snapshot(steps):
    process, states = run(steps)
    executor = fresh().exchange.nets["n"]
    done = 0
    for count, state in states:
        for entry in process.entries[done:count]:
            executor.replay(NET_ENTRY.decode(entry))
        done = count
        assert net_state(executor) == state
    for first, snapshot in states[:: max(1, len(states) // 4)]:
        executor = fresh().exchange.nets["n"]
        restore_net(executor, snapshot)
        assert net_state(executor) == snapshot
        for entry in process.entries[first:]:
            executor.replay(NET_ENTRY.decode(entry))
        assert net_state(executor) == states[-1][1]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(STEPS), max_size=25))
def test_an_action_of_which_it_is_on_file_that_it_has_ended_has_left_there_what_it_left(steps):
    """Wherever the file ends: before its transition fires a data object may have to be stored, or be looked at."""
    process, _ = run(steps)
    executor = fresh().exchange.nets["n"]
    for entry in process.entries:
        executor.replay(NET_ENTRY.decode(entry))
        for activity in executor.activities:
            if activity.reply is not None and activity.lineage.job is not None:
                assert activity.lineage.job.memory["ended"] == activity.number


@pytest.mark.parametrize("fits", [True, False])
def test_what_a_builder_leaves_in_memory_is_on_file_with_its_request(fits):
    """The net that is asked goes on when this process dies, and what comes next relies on what was noted."""
    front = parse_net(
        "net: n\nplaces: {idle: 1, kept: , bad: }\ntransitions:\n"
        "  look: {in: idle, out: kept, symbol: go, request: {to: m.serve, build: note}, on_failure: bad}\n"
        "  told: {in: kept, out: idle, emit: go_done}\n  missed: {in: bad, out: idle, emit: go_failed}"
    )
    back = parse_net(
        "net: m\nplaces: {asked: , done: , bad: }\nservices: {serve: {entry: asked, done: done, failed: bad}}\n"
        "transitions: {work: {in: asked, out: done, action: act, on_failure: bad}}"
    )

    def note(ctx: ActionContext) -> dict[str, object]:
        ctx.memory["looked"] = "p03" if fits else object()
        return {}

    functions, entries = {"note": note, "act": hold}, []

    def record(entry: NetEntry) -> None:
        entries.append(NET_ENTRY.content(entry))

    process = Process([front, back], functions, record=record)
    process.exchange.nets["m"].rule.record = None
    process.command("n", "go")
    process.pump()
    if not fits:
        assert not process.held, "nothing is asked for whose ground a journal cannot keep"
        assert "ctx.memory.looked is <object" in process.recorder.firings[-2].message
        return
    again = Process([front, back], functions).exchange.nets["n"]
    for entry in entries:
        again.replay(NET_ENTRY.decode(entry))
    (activity,) = again.activities
    assert activity.lineage.job.memory == {"looked": "p03"}
    assert net_state(again) == net_state(process.exchange.nets["n"])


NEXT = parse_net("""
net: n
places: {a: 1, b: , lost: }
transitions: {t: {in: a, out: b, action: f, on_failure: lost}}
""")


def test_what_was_brought_back_is_asked_about_when_its_node_fires_and_not_while_it_is_configured():
    """Until then those who are asked, and what an action that is done again needs, may not be there."""
    before = Process([NEXT], {"f": hold})
    before.pump()
    asked = []

    def ask(_):
        asked.append("f")
        return Answer(Outcome.DONE)

    back = Process([NEXT], {"f": hold}, clock=Clock(), asks={"f": ask})
    executor = back.exchange.nets["n"]
    restore_net(executor, net_state(before.exchange.nets["n"]))
    executor.resume()
    assert back.marking("n") == {"t.in_doubt": 1}
    assert not asked
    assert executor.next_wakeup() is not None
    back.pump()
    assert (asked, back.marking("n")) == (["f"], {"b": 1})


@settings(max_examples=30, deadline=None)
@given(st.lists(st.sampled_from(STEPS), max_size=25))
def test_what_was_brought_back_is_asked_about_and_goes_on(steps):
    process, states = run(steps)
    running = sorted(activity.transition for activity in process.exchange.nets["n"].activities)
    back = fresh()
    executor = back.exchange.nets["n"]
    restore_net(executor, states[-1][1])
    executor.resume()
    assert sorted(activity.transition for activity in executor.activities) == running
    assert {activity.state for activity in executor.activities} <= {ActivityState.IN_DOUBT}
    executor.post(ModeSet(Mode.AUTOMATIC))
    executor.post(PauseSet(False))
    back.wait(10.0)
    while back.held:
        back.end(back.held[0][1].transition)
    back.wait(10.0)
    assert not executor.activities
    told = [firing.message for firing in back.recorder.firings[: len(running)]]
    assert all("died" in message or "waited" in message for message in told)
    assert executor.marking()["tool"] == 1


json_data = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 2) | st.sampled_from([0.0, 1.0, -0.5, "", "a"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from("abc"), inner, max_size=3),
    max_leaves=12,
)


@settings(max_examples=100, deadline=None)
@given(json_data, json_data)
def test_data_with_their_difference_are_the_new_ones(old, new):
    change = json.loads(json.dumps(difference(old, new)))
    assert (change is None) == (json.dumps(old, sort_keys=True) == json.dumps(new, sort_keys=True))
    again = old if change is None else renewed(json.loads(json.dumps(old)), change)
    assert json.dumps(again, sort_keys=True) == json.dumps(new, sort_keys=True)


@pytest.mark.parametrize(
    "change", [[], ["keys", {}, []], ["items", {"7": ["set", 1]}, []], ["items", {"x": ["set", 1]}, []], "set", None]
)
def test_a_difference_that_does_not_fit_is_refused(change):
    with pytest.raises(NetError, match=r"is no change of|there is no item"):
        renewed([1, 2], change)


def test_the_entry_comes_before_what_it_tells():
    order: list[str] = []

    def act(ctx: ActionContext) -> None:
        order.append(f"action {ctx.transition}")

    net = parse_net("net: n\nplaces: {a: 1, b: , bad: }\ntransitions: {t: {in: a, out: b, action: f, on_failure: bad}}")

    def record(entry: NetEntry) -> None:
        order.append(f"{NET_ENTRY.content(entry)[0]} {process.marking('n')}")

    process = Process([net], {"f": act}, record=record)
    process.pump()
    assert order == ["fire {'a': 1}", "action t", "end {'t.active': 1}"]


def test_a_record_that_cannot_be_made_leaves_everything_as_it_was():
    def full(entry: NetEntry) -> None:
        raise OSError("no space left")

    net = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b}}")
    process = Process([net], record=full)
    with pytest.raises(OSError, match="no space"):
        process.exchange.nets["n"].pump()
    assert process.marking("n") == {"a": 1}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (object(), r"ctx\.memory\.x is <object object"),
        ({1: 2}, r"ctx\.memory\.x has the key 1"),
        ([0.0, float("nan")], r"ctx\.memory\.x\[1\] is nan"),
        (b"bytes", r"\(bytes\); a journal keeps"),
    ],
)
def test_what_json_cannot_carry_fails_the_action_that_made_it(value, message):
    net = parse_net(
        "net: n\nplaces: {idle: 1, a: , bad: }\ntransitions:\n"
        "  t: {in: idle, out: a, symbol: go, action: f, on_failure: bad}\n"
        "  u: {in: a, out: idle, emit: go_done}\n  v: {in: bad, out: idle, emit: go_failed}"
    )

    def f(ctx: ActionContext) -> None:
        ctx.memory["x"] = value
        ctx.result["good"] = 1

    process = Process([net], {"f": f}, record=NET_ENTRY.encode)
    process.command("n", "go")
    with pytest.raises(NetError, match=message):
        raise process.results[0].error
    assert process.results[0].results == {}
    with pytest.raises(NetError, match="arguments of command go"):
        process.command("n", "go", x=value)


def test_a_value_that_contains_itself_is_refused_like_any_other():
    process = Process(
        [parse_net(NET)], {"now": hold, "act": hold}, {"again": lambda ctx: False}, record=lambda entry: None
    )
    value: list[object] = []
    value.append(value)
    with pytest.raises(NetError, match="contains itself"):
        process.command("n", "go", x=value)


@pytest.mark.parametrize(
    "entry",
    [[], ["no"], [3], {}, None, ["fire", "no", None], ["fire", "plan.start", None], ["fire", "begin", None],
     ["fire", "begin"], ["fire", "begin", "1"], ["fire", "begin", True], ["fire", None, None],
     ["phase", 1, "move.cancel", ["a", "b", {}]],
     ["end", 1, "move.end", None, None], ["token", "nowhere", 1, None], ["token", "spare"],
     ["token", "spare", 1, []], ["end", 1, "move.end", None, ["data", {}, [], 0.5]], ["command", [1, "no", {}, 0, ""]],
     ["forgotten", 1, None], ["cancel", 1, None], ["mode", "fast"], ["pause", 1], ["guard", 3, ["a", "b", {}]]],
)  # fmt: skip
def test_an_entry_that_does_not_fit_is_refused(entry):
    executor = fresh().exchange.nets["n"]
    before = net_state(executor)
    with pytest.raises(NetError):
        executor.replay(NET_ENTRY.decode(entry))
    assert net_state(executor) == before


@given(
    st.sampled_from(sorted(net_state(fresh().exchange.nets["n"]))),
    st.sampled_from([None, "x", -1, [[1]], {"no": 1}, [{}]]),
)
def test_a_state_that_does_not_fit_is_refused(key, value):
    executor = fresh().exchange.nets["n"]
    state = net_state(executor)
    if (key, value) in (("serving", None), ("sequence", -1), ("entered", -1)):
        return
    with pytest.raises(NetError, match="no state of net n"):
        restore_net(executor, {**state, key: value})
