"""Commands that wait: which of the tape is read, commands that are held, and commands that one net hands to another."""

import json

from im_core.errors import ImError
from im_pnt.execution.events import CommandCancelled, CommandHeld, GuardsChanged, RequestArrived
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Command, Request
from im_pnt.netfile import parse_net
from im_pnt_node.distributed.codec import NET_ENTRY
from im_pnt_node.journal.state import net_state, restore_net
from support.process import Process, hold

LINE = """
net: n
places: {left: 2, right: 1, going: }
transitions:
  left: {symbol: move, in: left, out: left, guard: is_left, action: go, emit: move_done, on_failure: left}
  right: {symbol: move, in: right, out: right, guard: is_right, action: go, emit: move_done, on_failure: right}
"""


def line() -> tuple[Process, list[str]]:
    """A net whose two transitions read the same symbol, each only with one argument, and what its journal is told."""
    written: list[str] = []
    guards = {f"is_{side}": lambda ctx, side=side: ctx.command.arguments["side"] == side for side in ("left", "right")}
    return Process(
        [parse_net(LINE)], {"go": hold}, guards, record=lambda e: written.append(NET_ENTRY.encode(e))
    ), written


def going(process: Process) -> list[int]:
    return [ctx.command.id for _, _, ctx in process.held]


def test_a_symbol_that_its_guard_holds_back_lets_those_behind_it_pass():
    process, written = line()
    first, second = process.command("n", "move", side="right"), process.command("n", "move", side="right")
    third = process.command("n", "move", side="left")
    assert going(process) == [first, third]
    process.end("right")
    assert going(process) == [third, second]
    process.end("left")
    process.end("right")
    assert [result.success for result in process.results] == [True] * 3
    assert_replayed(process, written)


def test_a_command_that_is_held_begins_nothing_more_and_goes_on_where_it_was():
    chain = parse_net(
        """
net: n
places: {a: , b: }
transitions:
  one: {symbol: go, out: a, action: go, on_failure: b}
  two: {in: a, out: b, action: go, on_failure: b}
  tell: {in: b, emit: go_done}
"""
    )
    written: list[str] = []
    process = Process([chain], {"go": hold}, record=lambda e: written.append(NET_ENTRY.encode(e)))
    net = process.exchange.nets["n"]
    first, second = process.command("n", "go"), process.command("n", "go")
    net.post(CommandHeld(first, True))
    process.pump()
    process.end("one")  # what runs ends, and the other command is not held
    process.end("one")
    assert going(process) == [second]
    net.post(GuardsChanged())
    process.pump()
    assert going(process) == [second]
    process.end("two")
    assert len(process.results) == 1
    assert_replayed(process, written)
    net.post(CommandHeld(first, False))
    process.pump()
    assert going(process) == [first]
    process.end("two")
    assert [result.success for result in process.results] == [True, True]
    assert_replayed(process, written)


def test_a_command_that_is_held_is_not_even_read_from_the_tape():
    process, written = line()
    busy = process.command("n", "move", side="right")
    held, behind = process.command("n", "move", side="right"), process.command("n", "move", side="right")
    process.exchange.nets["n"].post(CommandHeld(held, True))
    process.pump()
    assert going(process) == [busy]
    process.end("right")
    assert going(process) == [behind]
    process.end("right")
    assert going(process) == []
    assert_replayed(process, written)
    process.exchange.nets["n"].post(CommandHeld(held, False))
    process.pump()
    assert going(process) == [held]


SERVER = """
net: n
places: {wanted: , served: , refused: , idle: {tokens: 1, resource: true}, begun: }
services: {work: {entry: wanted, done: served, failed: refused}}
at_once: 9
transitions:
  work: {in: wanted, out: served, action: go, on_failure: refused}
  begin: {symbol: go, in: idle, out: begun}
  finish: {in: begun, out: idle, emit: go_done}
"""


def asked(number: int, scope: str) -> RequestArrived:
    """Another node's request, or one of another net here, for a command."""
    node = "" if scope.startswith("node/") else "other"
    return RequestArrived(Request(f"r-{scope}", "n", "work", node, "front", "ask", Command(number, scope=scope), {}))


def test_a_command_that_is_held_holds_none_of_another_node_that_has_its_number():
    written: list[str] = []
    process = Process([parse_net(SERVER)], {"go": hold}, record=lambda e: written.append(NET_ENTRY.encode(e)))
    net = process.exchange.nets["n"]
    net.post(CommandHeld(1, True, "node/1"))
    assert process.command("n", "go") == 1
    for scope in ("other/1", "third/1", "node/1"):
        net.post(asked(1, scope))
    process.pump()
    assert [ctx.command.scope for _, _, ctx in process.held] == ["other/1", "third/1"]
    process.end("work")
    assert_replayed(process, written)
    net.post(CommandHeld(1, False))
    process.pump()
    assert [ctx.command.scope for _, _, ctx in process.held] == ["third/1", "node/1"]
    assert [result.success for result in process.results] == [True]
    assert_replayed(process, written)


def test_a_command_that_is_held_is_still_held_after_its_state_was_brought_back():
    process = Process([parse_net(SERVER)], {"go": hold}, record=lambda _: None)
    process.exchange.nets["n"].post(CommandHeld(1, True, "node/1"))
    process.pump()
    state = net_state(process.exchange.nets["n"])
    again = Process([parse_net(SERVER)], {"go": hold})
    restore_net(again.exchange.nets["n"], json.loads(json.dumps(state)))
    for scope in ("other/1", "node/1"):
        again.exchange.nets["n"].post(asked(1, scope))
    again.pump()
    assert [ctx.command.scope for _, _, ctx in again.held] == ["other/1"]
    for line, entry in (
        (["hold", 1, True, ""], CommandHeld(1, True)),
        (["hold", 1, True, "a/1"], CommandHeld(1, True, "a/1")),
    ):
        assert NET_ENTRY.decode(line) == entry
        assert NET_ENTRY.content(entry) == line


FRONT = """
net: front
places: {arm: {tokens: 1, resource: true}, go_failed: }
transitions:
  go: {symbol: go, in: arm, out: arm, request: back.go, emit: go_done, on_failure: go_failed}
  go_failed: {in: go_failed, out: arm, emit: go_failed}
"""
BACK = """
net: back
places: {idle: 1, done: , missed: }
transitions:
  begin: {symbol: go, in: idle, out: done, action: work, on_failure: missed}
  tell: {in: done, out: idle, emit: go_done}
  tell_missed: {in: missed, out: idle, emit: go_failed}
"""


def test_a_command_that_is_handed_on_brings_arguments_results_failure_and_cancel():
    process = Process([parse_net(FRONT), parse_net(BACK)], {"work": hold})

    def at_work() -> ActionContext:
        return process.held[0][2]

    process.command("front", "go", to="shelf")
    assert at_work().request_arguments == {"to": "shelf"}
    at_work().result["found"] = 3
    process.end("begin")
    number = process.command("front", "go")
    at_work().result["message"] = "half of it"
    process.end("begin", ImError("no way", code="blocked"))
    process.command("front", "go")
    process.exchange.nets["front"].post(CommandCancelled(number + 1, ImError("enough", code="cancelled")))
    process.pump()
    assert at_work().cancelled
    process.end("begin", ImError("stopped", code="cancelled"))
    results = process.results
    assert [result.success for result in results] == [True, False, False]
    assert [result.results for result in results] == [{"found": 3}, {"message": "half of it"}, {}]
    assert [result.error and result.error.code for result in results] == [None, "blocked", "cancelled"]


def assert_replayed(process: Process, written: list[str]) -> None:
    """A journal brings back what is there now."""
    executor = process.exchange.nets["n"]
    functions = process.functions
    again = Process([executor.written], functions.actions, functions.guards).exchange.nets["n"]
    for text in written:
        again.replay(NET_ENTRY.decode(json.loads(text)))
    again.rule.record = executor.record
    assert net_state(again) == net_state(executor)
