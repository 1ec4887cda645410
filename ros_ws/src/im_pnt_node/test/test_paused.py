"""Work that comes back in another run of the machine is paused, in all processes, until somebody resumes or ends it."""

import pytest

from im_core.errors import ImError
from im_pnt.execution.events import Answer, CommandCancelled, CommandHeld, Outcome
from im_pnt.execution.jobs import Command
from im_pnt.netfile import parse_net
from im_pnt_node.journal.state import net_state, restore_net
from support.journalled import JournalledProcess
from support.memory_files import MemoryFiles
from support.process import Clock, Process, hold

FRONT = parse_net(
    """
net: front
places: {idle: {tokens: 1, resource: true}, a: , b: , c: , d: , back: {remote: true}, bad: }
transitions:
  begin: {in: idle, out: a, symbol: go}
  first: {in: a, out: b, action: first, on_failure: bad}
  ask: {in: b, out: c, request: middle.work, on_failure: bad}
  second: {in: c, out: d, action: second, on_failure: bad}
  send: {in: d, out: middle.visited}
  finish: {in: back, out: idle, emit: go_done}
  give_up: {in: bad, out: idle, emit: go_failed}
"""
)
MIDDLE = parse_net(
    """
net: middle
places: {wanted: , asked: , good: , bad: , visited: {remote: true}, seen: }
services: {work: {entry: wanted, done: good, failed: bad}}
transitions:
  dig: {in: wanted, out: asked, action: dig, on_failure: bad}
  pass_on: {in: asked, out: good, request: far.work, on_failure: bad}
  look: {in: visited, out: seen, action: look, on_failure: seen}
  return: {in: seen, out: front.back}
"""
)
FAR = parse_net(
    """
net: far
places: {wanted: , half: , good: , bad: }
services: {work: {entry: wanted, done: good, failed: bad}}
transitions:
  half: {in: wanted, out: half, action: half, on_failure: bad}
  fill: {in: half, out: good, action: fill, on_failure: bad}
"""
)
NETS = {"front": FRONT, "middle": MIDDLE, "far": FAR}
ACTIONS = ("first", "dig", "half", "fill", "second", "look")


class Machine:
    """Three processes on a network that delivers one packet a step; all die and are started at once."""

    def __init__(self) -> None:
        self.now = 0.0
        self.files = {name: MemoryFiles(name) for name in NETS}
        self.begun: list[str] = []
        self.results: list[bool] = []
        self.flying: list[tuple[str, str]] = []
        self.alive: dict[str, JournalledProcess] = {}

    def start(self, run: str, resumes: bool = False) -> None:
        actions = {name: lambda ctx: self.begun.append(ctx.transition) for name in ACTIONS}
        self.flying.clear()
        for name, net in NETS.items():
            self.files[name] = self.files[name].reborn()
            self.alive[name] = JournalledProcess(
                name,
                [net],
                self.files[name],
                actions=actions,
                transmit=lambda node, packet: self.flying.append((node, packet)),
                clock=lambda: self.now,
                run=run,
                resumes=resumes,
            )
        for job in self.front.jobs():
            job.on_closed = lambda result: self.results.append(result.success)

    @property
    def front(self):
        return self.alive["front"].exchange.nets["front"]

    def step(self) -> None:
        """One packet arrives, or time passes."""
        if self.flying:
            node, packet = self.flying.pop(0)
            self.alive[node].link.hear(packet)
        else:
            self.now += 0.05
        for process in self.alive.values():
            process.turn()
            process.tick()

    def go(self) -> None:
        self.front.command(Command(1, "go", scope="front/1"), lambda result: self.results.append(result.success))

    def run(self, steps: int = 150) -> None:
        for _ in range(steps):
            self.step()


def die_after(steps: int) -> Machine:
    machine = Machine()
    machine.start("one")
    machine.run(20)
    machine.go()
    machine.run(steps)
    return machine


STEPS = range(13)  # one after the other all of its actions have begun


@pytest.fixture(scope="module")
def unkilled():
    machine = die_after(150)
    assert machine.results == [True]
    assert machine.begun == [*ACTIONS]
    return machine.begun


@pytest.mark.parametrize("steps", STEPS)
def test_in_another_run_nothing_begins_until_it_is_resumed_also_after_a_further_death(unkilled, steps):
    machine = die_after(steps)
    done = list(machine.begun)
    for run in ("two", "two", "three"):
        machine.start(run)
        machine.run()
        assert machine.begun == done, "nothing begins because the machine was started"
        if machine.front.jobs():
            assert machine.front.paused
    machine.front.post(CommandHeld(1, False, "front/1"))
    machine.run()
    assert not machine.front.jobs()
    if done:  # else it died before the command was on file
        assert machine.begun == unkilled


@pytest.mark.parametrize("steps", STEPS)
def test_what_is_ended_while_it_is_paused_begins_nothing_more_of_its_work(steps):
    """Its nets do not look for a cancellation: no action runs to be called off, so the next one fails."""
    machine = die_after(steps)
    done = list(machine.begun)
    machine.start("two")
    machine.run(100)
    machine.front.post(CommandCancelled(1, ImError("not wanted", code="cancelled")))
    machine.run()
    assert not any(net.jobs() for process in machine.alive.values() for net in process.exchange.nets.values())
    assert machine.begun == done


@pytest.mark.parametrize("steps", STEPS)
def test_in_the_same_run_and_where_whoever_starts_it_says_so_it_goes_on_by_itself(unkilled, steps):
    for run, resumes in (("one", False), ("two", True)):
        machine = die_after(steps)
        on_file = bool(machine.begun)
        machine.start(run, resumes)
        machine.run()
        assert not machine.front.jobs()
        if on_file:
            assert machine.begun == unkilled


def test_a_start_that_resumes_goes_on_with_what_an_earlier_one_has_paused(unkilled):
    machine = die_after(12)
    machine.start("two")
    machine.run(50)
    machine.start("three", resumes=True)
    machine.run()
    assert machine.begun == unkilled


TIMED = parse_net(
    """
net: n
places: {a: , b: , bad: }
transitions:
  begin: {symbol: go, out: a}
  work: {in: a, out: b, action: f, on_failure: bad, on_doubt: a}
  finish: {in: b, emit: go_done}
  fail: {in: bad, emit: go_failed}
"""
)


def test_what_becomes_of_an_action_is_not_asked_while_its_command_is_paused_for_to_ask_may_do_it_again():
    before = Process([TIMED], {"f": hold})
    before.command("n", "go")
    asked = []

    def ask(context):
        asked.append(context.transition)
        return Answer(Outcome.DONE)

    back = Process([TIMED], {"f": hold}, clock=Clock(), asks={"f": ask})
    executor = back.exchange.nets["n"]
    restore_net(executor, net_state(before.exchange.nets["n"]))
    back.exchange.hold_all(True)
    executor.resume()
    back.wait(100.0)
    assert (asked, back.marking("n")) == ([], {"work.in_doubt": 1})
    executor.post(CommandHeld(1, False, "node/1"))
    back.wait(1.0)
    assert (asked, back.marking("n")) == (["work"], {})


SLOW = parse_net(
    """
net: slow
places: {wanted: , good: , bad: , go: {remote: true}}
services: {work: {entry: wanted, done: good, failed: bad}}
transitions: {end: {in: [wanted, go], out: good, guard: not cancelled}, stop: {in: wanted, out: bad, guard: cancelled}}
"""
)
HURRY = parse_net(
    """
net: hurry
places: {a: , b: , bad: }
transitions:
  begin: {symbol: go, out: a}
  ask: {in: a, out: b, request: slow.work, timeout: 10.0, on_failure: bad}
  finish: {in: b, emit: go_done}
  fail: {in: bad, emit: go_failed}
"""
)


def test_the_time_of_a_request_does_not_run_out_while_its_command_is_paused():
    process = Process([HURRY, SLOW], clock=Clock())
    process.command("hurry", "go")
    process.exchange.hold_all(True)
    process.wait(100.0)
    process.exchange.nets["hurry"].post(CommandHeld(1, False, "node/1"))
    process.wait(9.0)
    assert process.marking("hurry") == {"ask.active": 1}
    assert not process.exchange.nets["slow"].paused
    process.wait(2.0)
    assert [result.success for result in process.results] == [False]
