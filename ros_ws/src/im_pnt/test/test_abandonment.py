"""Abandoned commands: they end at once, though nothing fires, and the nets are as if they had not begun."""

import pytest

from im_core.errors import ImError
from im_pnt.execution.abandonment import abandonment
from im_pnt.execution.events import CommandCancelled, GuardsChanged
from im_pnt.netfile import parse_net
from support.process import Clock, Process, hold

STUCK = """
net: n
places: {idle: 2, tool: 1, chosen: , path: {data_object: path}, done: , bad: }
transitions:
  begin: {in: idle, out: [chosen, path], symbol: go}
  take: {in: [chosen, tool], out: done, guard: never}
  act: {in: [path, tool], out: [path, tool], action: act, on_failure: [bad, tool], timeout: 1, guard: first}
  finish: {in: [done, path], out: [idle, tool], emit: go_done}
  give_up: {in: [bad, chosen], out: idle, emit: go_failed}
"""


def abandon(process: Process, net: str, number: int) -> ImError:
    executor = process.exchange.nets[net]
    (job,) = [job for job in executor.jobs() if job.command.id == number]
    error = abandonment(process.exchange.nets.values(), job.command, "abandoned by the operator")
    executor.post(CommandCancelled(number, error))
    process.pump()
    return error


def stuck(first: bool, clock: Clock | None = None) -> tuple[Process, list[bool]]:
    allowed = [first]
    guards = {"never": lambda ctx: False, "first": lambda ctx: allowed[0]}
    return Process([parse_net(STUCK)], {"act": hold}, guards, clock=clock or Clock()), allowed


def test_a_command_that_nothing_ends_is_abandoned_though_a_cancel_leaves_it():
    process, _ = stuck(first=False)
    number = process.command("n", "go")
    process.exchange.nets["n"].post(CommandCancelled(number, ImError("enough", code="cancelled")))
    process.pump()
    assert not process.results
    error = abandon(process, "n", number)
    assert [(each.success, each.error) for each in process.results] == [(False, error)]
    assert error.facts["held"] == ["n.chosen", "n.path (node/1/path)"]
    assert error.facts["freed"] == ["n.idle"]
    assert process.marking("n") == {"idle": 2, "tool": 1}
    assert process.exchange.nets["n"].at_rest()


def test_an_action_under_way_is_called_off_and_not_awaited_and_what_it_held_is_anothers():
    process, allowed = stuck(first=True)
    first = process.command("n", "go")
    allowed[0] = False
    process.command("n", "go")
    ((owner, activity, _),) = process.held
    called: list[str] = []
    activity.when_cancelled(lambda: called.append("off"))
    error = abandon(process, "n", first)
    assert called == ["off"]
    assert error.facts["actions"] == ["function act of n.act"]
    assert "under way, cancelled and not awaited: function act of n.act" in error.message
    assert process.marking("n") == {"idle": 1, "tool": 1, "chosen": 1, "path": 1}
    allowed[0] = True
    process.exchange.nets["n"].post(GuardsChanged())
    process.pump()
    assert process.marking("n") == {"idle": 1, "chosen": 1, "act.active": 1}, "the second has the tool"
    owner.ended(activity, None)
    process.pump()
    assert process.marking("n") == {"idle": 1, "chosen": 1, "act.active": 1}, "a late end changes nothing"
    assert process.recorder.names("n")[-2:] == ["act!", "act+"]


def test_the_server_of_an_abandoned_action_is_idle_again():
    net = parse_net(
        "net: n\nplaces: {a: , b: }\ncommands: {go: }\ntransitions:\n"
        "  t: {symbol: go, out: a, action: f, on_failure: a, servers: 1}\n  u: {in: a, emit: go_done}"
    )
    process = Process([net], {"f": hold})
    first = process.command("n", "go")
    process.command("n", "go")
    assert process.marking("n") == {"t.active": 1}
    abandon(process, "n", first)
    assert process.marking("n") == {"t.active": 1}, "the second is worked on"
    process.end("t")
    assert process.marking("n") == {"t.active": 1}, "a late end changes nothing"
    process.end("t")
    assert process.marking("n") == {"t.servers": 1}


def test_what_is_in_doubt_is_said_and_not_asked_about_any_more():
    process, _ = stuck(first=True, clock=Clock())
    number = process.command("n", "go")
    process.wait(2.0)
    error = abandon(process, "n", number)
    assert error.facts["doubts"] == ["function act of n.act (waited 1 s for function act of transition act, in vain)"]
    process.wait(100.0)
    assert process.recorder.names("n")[-1] == "act!"
    assert process.exchange.nets["n"].next_wakeup() is None


CALLER = """
net: caller
places: {idle: 1, end: , bad: }
transitions:
  ask: {in: idle, out: end, symbol: go, request: server.s, on_failure: bad}
  finish: {in: end, out: idle, emit: go_done}
  fail: {in: bad, out: idle, emit: go_failed}
"""
SERVER = """
net: server
places: {entry: , good: , bad: , lamp: 1, lit: }
services: {s: {entry: entry, done: good, failed: bad}}
transitions:
  light: {in: [entry, lamp], out: lit}
  work: {in: lit, out: [good, lamp], guard: never}
"""


@pytest.mark.parametrize("cancelled", [False, True])
def test_the_net_that_was_asked_abandons_the_request_and_serves_the_next(cancelled):
    ready = [False]
    process = Process([parse_net(CALLER), parse_net(SERVER)], guards={"never": lambda ctx: ready[0]})
    number = process.command("caller", "go")
    if cancelled:  # the net that was asked is told once more
        process.exchange.nets["caller"].post(CommandCancelled(number, ImError("enough", code="cancelled")))
        process.pump()
    error = abandon(process, "caller", number)
    assert error.facts["held"] == ["server.lit"]
    assert error.facts["freed"] == ["caller.idle", "server.lamp", "server.SI"]
    assert process.marking("caller") == {"idle": 1}
    assert process.marking("server") == {"lamp": 1, "SI": 1, "SO": 1}
    assert not process.exchange.book.items()
    assert not process.recorder.troubles
    ready[0] = True
    process.command("caller", "go")
    assert [each.success for each in process.results] == [False, True]


def test_a_symbol_on_the_tape_is_taken_off():
    process = Process(
        [parse_net(STUCK.replace("idle: 2", "idle: 1"))],
        {"act": hold},
        {"never": lambda ctx: False, "first": lambda ctx: False},
    )
    process.command("n", "go")
    waiting = process.command("n", "go")
    assert abandon(process, "n", waiting).facts["held"] == ["symbol go on the tape of n"]
    assert process.marking("n") == {"tool": 1, "chosen": 1, "path": 1}


def test_a_thing_that_a_command_has_made_stays_and_nothing_comes_back_for_it():
    net = parse_net(
        """
net: n
places: {empty: {tokens: 2, resource: true}, full: {resource: true}, asked: , placed: }
transitions:
  begin: {out: asked, symbol: fill}
  put: {in: [asked, empty], out: [placed, full], guard: may_put}
  tell: {in: placed, emit: fill_done, guard: never}
  use: {in: full, out: empty, symbol: drain, emit: drain_done}
"""
    )
    may_put = [True]
    process = Process([net], guards={"may_put": lambda ctx: may_put[0], "never": lambda ctx: False})
    abandon(process, "n", process.command("n", "fill"))
    assert process.marking("n") == {"empty": 1, "full": 1}
    may_put[0] = False
    abandon(process, "n", process.command("n", "fill"))
    assert process.marking("n") == {"empty": 1, "full": 1}
