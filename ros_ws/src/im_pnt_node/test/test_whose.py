"""Whose work a token is: commands that meet in one net do not touch each other.

Random nets run many commands over shared resources, forks, joins, failures and requests. What a command has to do is
known from how its net was made: whether it did that, all of it and nothing else, shows whose its tokens were. Parts of
it are done in a second net, in the same process or in another one, which a journal brings back from the dead.
"""

import json
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.errors import NetFileError
from im_pnt.execution.abandonment import abandonment
from im_pnt.execution.actions import ActionOwner
from im_pnt.execution.events import CommandCancelled, CommandHeld, GuardsChanged
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Activity, Command, CommandResult
from im_pnt.model.action import FunctionAction, RequestAction
from im_pnt.model.net import Guard, Net, Place, RemotePlace, Transition
from im_pnt.model.resources import resource_places
from im_pnt.netfile import parse_net
from im_pnt_node.distributed.codec import NET_ENTRY
from im_pnt_node.distributed.packets import Message, decode_message, numbered
from im_pnt_node.journal.state import net_state
from support.journalled import JournalledProcess
from support.memory_files import MemoryFiles
from support.process import Clock, Process, hold

SERVERS = [
    parse_net(
        f"""
net: server
at_once: {at_once}
places: {{asked: , busy: , done: , failed: , tool: {tools}}}
services: {{work: {{entry: asked, done: done, failed: failed}}}}
transitions:
  take: {{in: [asked, tool], out: [busy, tool]}}
  serve: {{in: busy, out: done, action: serve, on_failure: failed}}
"""
    )
    for at_once, tools in ((1, 1), (2, 1), (3, 2))
]
TOOLS = ("zone", "camera")
CANCELLED = Guard("cancelled")


@dataclass
class Made:
    """A net in the making: its parts, and what each command has to do."""

    places: dict[str, Place] = field(default_factory=dict)
    transitions: dict[str, Transition] = field(default_factory=dict)
    duties: dict[str, dict[str, int]] = field(default_factory=dict)
    stage: int = 0

    def place(self, name: str, *, remote: bool = False) -> str:
        self.places[name] = Place(name, remote=remote)
        return name

    def transition(self, name: str, inputs: list[str], outputs: list[str], action: str | None = None, **more) -> None:
        act = RequestAction("server", "work") if action == "ask" else FunctionAction(action) if action else None
        arcs = {"inputs": dict.fromkeys(inputs, 1), "outputs": dict.fromkeys(outputs, 1)}
        self.transitions[name] = Transition(name, **arcs, action=act, **more)

    def step(self, here: str, there: str, kind: str, symbol: str, tool: list[str], gives: list[str]) -> None:
        """A thing that a command does; where it fails, that is mended, and the command goes on."""
        name, trouble = f"{here}_{kind}", self.place(f"{here}_trouble")
        self.transition(name, [here, *tool], [there, *gives], kind, on_failure=dict.fromkeys([trouble, *gives], 1))
        self.transition(f"{name}_mended", [trouble], [there], "mend", on_failure={there: 1})
        self.duties[symbol][name] = self.stage

    def go_on(self) -> None:
        """What comes now is done when all before it has been done."""
        self.stage += 1

    def cross(self, here: str, net: str, place: str) -> None:
        """A token goes to another net."""
        self.transitions[f"{here}_cross"] = Transition(
            f"{here}_cross", inputs={here: 1}, remote_outputs={RemotePlace(net, place): 1}
        )

    def choice(self, here: str, there: str, tool: str) -> None:
        for name, guard, action in (("on", Guard("cancelled", negated=True), "goes_on"), ("off", CANCELLED, "is_off")):
            self.transition(
                f"{here}_{name}", [here, tool], [there, tool], action, guard=guard, on_failure={there: 1, tool: 1}
            )


def nets_of(
    dice: random.Random, kinds: tuple[str, ...] = ("act", "hold", "hold", "hold", "ask")
) -> tuple[Net, Net, dict[str, dict[str, int]]]:
    """Nets in which commands do one thing after the other, and some with a tool that all share; and parts in another.

    Returns:
        The net of the commands, the other one, and what is to be done for each symbol, in which order.
    """
    made = Made()
    far = Made({"vice": Place("vice", 1, resource=True)}, duties=made.duties)
    for tool in TOOLS:
        made.places[tool] = Place(tool, dice.randint(1, 2), resource=dice.choice([None, True]))
    for symbol in ("go", "run"):
        made.duties[symbol] = {}
        idle = [f"{symbol}_idle"] if dice.random() < 0.5 else []
        carries = dice.choice([None, False])
        made.places |= {name: Place(name, dice.randint(1, 3), resource=carries) for name in idle}
        here = made.place(f"{symbol}0")
        made.transition(f"{symbol}_begin", idle, [here], symbol=symbol)
        for number in range(1, dice.randint(2, 5)):
            there, tool = made.place(f"{symbol}{number}"), dice.choice(TOOLS)
            made.go_on()
            far.stage = made.stage
            match dice.choice(["step", "passing", "holding", "fork", "choice", "abroad", "abroad", "both"]):
                case "abroad":
                    made.cross(here, "m", abroad(far, dice, there, kinds, symbol, dice.randint(1, 2)))
                    made.place(there, remote=True)
                    made.stage = far.stage
                case "both":
                    near, gone = made.place(f"{there}_near"), made.place(f"{there}_gone")
                    made.transition(f"{there}_part", [here], [near, gone])
                    made.cross(gone, "m", abroad(far, dice, f"{there}_back", kinds, symbol, 1))
                    made.place(f"{there}_back", remote=True)
                    made.step(near, made.place(f"{there}_done"), dice.choice(kinds), symbol, [], [])
                    made.transition(f"{there}_meet", [f"{there}_done", f"{there}_back"], [there])
                case "step":
                    made.step(here, there, dice.choice(kinds), symbol, [], [])
                case "passing":
                    made.step(here, there, dice.choice(kinds), symbol, [tool], [tool])
                case "holding":
                    mid = made.place(f"{there}_mid")
                    made.step(here, mid, dice.choice(kinds), symbol, [tool], [])
                    made.go_on()
                    made.step(mid, there, dice.choice(kinds), symbol, [], [tool])
                case "fork":
                    arms = [[made.place(f"{there}_{arm}{end}") for end in "ab"] for arm in "lr"]
                    made.transition(f"{there}_fork", [here], [begin for begin, _ in arms])
                    for begin, end in arms:
                        made.step(begin, end, dice.choice(kinds), symbol, [], [])
                    made.transition(f"{there}_join", [end for _, end in arms], [there])
                case "choice":
                    made.choice(here, there, tool)
            here = there
        made.transition(f"{symbol}_end", [here], idle, emit=(f"{symbol}_done",))
    return Net("n", made.places, made.transitions), Net("m", far.places, far.transitions), made.duties


def abroad(far: Made, dice: random.Random, back: str, kinds: tuple[str, ...], symbol: str, steps: int) -> str:
    """What is done in the other net, which sends a token back; returns the place where it begins."""
    here = far.place(f"{back}_here", remote=True)
    for number in range(steps):
        there, vice = far.place(f"{back}_{number}"), ["vice"] if dice.random() < 0.5 else []
        if dice.random() < 0.3:
            far.choice(here, chosen := far.place(f"{back}_{number}_chosen"), "vice")
            here = chosen
        far.step(here, there, dice.choice(kinds), symbol, vice, vice)
        here = there
        far.go_on()
    far.cross(here, "n", back)
    return f"{back}_here"


class Wire:
    """Carries messages between two processes, in order; they are written and read as by a link.

    Args:
        sender: Node that sends.
        nodes: The process of each node.
    """

    def __init__(self, sender: str, nodes: dict[str, Process], flying: list[tuple[str, str, str]]) -> None:
        self.sender, self.nodes, self.flying = sender, nodes, flying

    def node_of(self, net: str) -> str:
        return "far" if net == "m" else "near"

    def send(self, node: str, message: Message) -> None:
        self.flying.append((self.sender, node, numbered(1, message)))

    def forget(self, request_id: str) -> None:
        raise AssertionError(request_id)

    def keeps_journal(self, node: str) -> bool:
        return False


class Run:
    """Commands in a net, with another one beside it or in another process; what an action is told must be its own."""

    def __init__(self, net: Net, far: Net, duties: dict[str, dict[str, int]], seed: int) -> None:
        self.duties, self.far = duties, far
        self.wrong: list[str] = []
        self.done: dict[int, list[str]] = {}
        self.asked: dict[int, str] = {}
        self.ended: dict[int, CommandResult] = {}
        self.cancelled: set[int] = set()
        self.told: list[int] = []
        self.heard: set[Activity] = set()
        actions = {each.__name__: each for each in (self.act, self.mend, self.serve, self.goes_on, self.is_off)}
        actions["hold"] = hold
        near, together = [net, SERVERS[seed % len(SERVERS)]], seed % 2 == 0
        self.flying: list[tuple[str, str, str]] = []
        self.nodes: dict[str, Process] = {}
        for name, nets in ({"near": [*near, far]} if together else {"near": near, "far": [far]}).items():
            wire = Wire(name, self.nodes, self.flying)
            self.nodes[name] = Process(nets, actions, seed=seed, name=name, transport=wire)
        self.process = self.nodes["near"]
        self.entries: dict[str, list[str]] = {"n": [], "server": [], "m": []}
        for name, executor in self.nets().items():
            entries = self.entries[name]
            executor.rule.record = lambda entry, entries=entries: entries.append(NET_ENTRY.encode(entry))

    def nets(self) -> dict[str, Executor]:
        return {name: executor for node in self.nodes.values() for name, executor in node.exchange.nets.items()}

    def held(self) -> list[tuple[ActionOwner, Activity, ActionContext]]:
        return [held for node in self.nodes.values() for held in node.held]

    def pump(self) -> None:
        """Lets everything happen; messages cross one by one."""
        for node in self.nodes.values():
            node.pump()
        while self.flying:
            sender, receiver, text = self.flying.pop(0)
            node = self.nodes[receiver]
            assert not node.exchange.receive(sender, decode_message(json.loads(text)[1:]))
            for each in self.nodes.values():
                each.pump()

    def act(self, ctx: ActionContext) -> None:
        self.does(ctx)
        if len(self.done[ctx.command.id]) % 3 == 0:
            raise ImError("broke", code="broke", command=ctx.command.id)

    def expect(self, ctx: ActionContext, **truths: bool) -> None:
        self.wrong += [f"{ctx.transition} for {ctx.command}: {what}" for what, true in truths.items() if not true]

    def does(self, ctx: ActionContext) -> None:
        """Something is done for a command: it finds what is its own, and leaves its mark."""
        number, done = ctx.command.id, self.done.setdefault(ctx.command.id, [])
        stages = self.duties[ctx.command.symbol]
        self.expect(
            ctx,
            arguments=ctx.command.arguments == {"number": number},
            result=ctx.result.get("number", number) == number,
            memory=ctx.memory.get("number", number) == number,
            replies=all(reply == {"number": number} for reply in ctx.replies.values()),
            order=all(
                name in (*done, *ctx.replies) or self.asked_elsewhere(name, ctx.transition)
                for name in stages
                if stages[name] < stages[ctx.transition]
            ),
        )
        ctx.result["number"] = ctx.result[ctx.transition] = ctx.memory["number"] = number
        done.append(ctx.transition)

    def asked_elsewhere(self, name: str, transition: str) -> bool:
        """Whether a request was, or may have been, asked in another visit: its reply is known there, and then gone."""
        return name.endswith("_ask") and (name in self.far.transitions or transition in self.far.transitions)

    def mend(self, ctx: ActionContext) -> None:
        self.expect(
            ctx,
            failure=ctx.failure is not None and ctx.failure.facts.get("command") == ctx.command.id,
            last=ctx.last_failure is not None and ctx.last_failure.facts.get("command") == ctx.command.id,
        )

    def serve(self, ctx: ActionContext) -> None:
        self.expect(ctx, arguments=ctx.request_arguments == {"number": ctx.command.id})
        ctx.result["number"] = ctx.command.id

    def goes_on(self, ctx: ActionContext) -> None:
        self.expect(ctx, cancelled=ctx.command.id not in self.cancelled)

    def is_off(self, ctx: ActionContext) -> None:
        self.expect(ctx, not_cancelled=ctx.command.id in self.cancelled)

    def command(self, symbol: str) -> None:
        number = len(self.asked) + 1
        self.asked[number] = symbol
        executor = self.nets()["n"]
        job = executor.command(
            Command(number, symbol, {"number": number}),
            lambda result: self.ended.__setitem__(number, result),
        )
        assert job.command.id == number
        self.pump()

    def end(self, held: tuple[object, Activity, ActionContext], fails: bool) -> None:
        owner, activity, ctx = held
        next(node for node in self.nodes.values() if held in node.held).held.remove(held)
        self.does(ctx)
        owner.ended(activity, ImError("no", code="no", command=ctx.command.id) if fails else None)
        self.pump()

    def cancel(self, number: int) -> None:
        """A cancel stops exactly the actions of its own command."""
        for _, activity, ctx in self.held():
            if activity not in self.heard:
                self.heard.add(activity)
                ctx.on_cancel(lambda whose=ctx.command.id: self.told.append(whose))
        wanted = {n for _, a, c in self.held() if (n := c.command.id) == number and not a.cancelled}
        self.told.clear()
        if number not in self.ended:
            self.cancelled.add(number)
        self.nets()["n"].post(CommandCancelled(number, ImError("off", code="off", command=number)))
        self.pump()
        assert set(self.told) == wanted

    def check(self) -> None:
        """Nobody has seen or done what is another's; a journal tells it the same."""
        assert not self.wrong
        for name, executor in self.nets().items():
            again = Process([executor.written], self.process.functions.actions).exchange.nets[name]
            for text in self.entries[name]:
                again.replay(NET_ENTRY.decode(json.loads(text)))
            again.rule.record = executor.record
            assert net_state(again) == net_state(executor)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32))
def test_commands_that_share_a_net_do_not_touch_each_other(seed):
    dice = random.Random(seed)
    net, far, duties = nets_of(dice)
    assert set(TOOLS) <= resource_places(net) | {tool for tool in TOOLS if not consumers(net, tool)}
    run = Run(net, far, duties, seed)
    for _ in range(dice.randint(10, 40)):
        match dice.choice(["go", "go", "run", "end", "end", "end", "fail", "cancel"]):
            case ("go" | "run") as symbol if len(run.asked) < 8:
                run.command(symbol)
            case "cancel" if run.asked:
                run.cancel(dice.choice(list(run.asked)))
            case ("end" | "fail") as how if run.held():
                run.end(dice.choice(run.held()), how == "fail")
    run.check()
    while run.held():
        run.end(run.held()[0], False)
    run.check()
    for number, symbol in run.asked.items():
        begun = number in run.done or run.ended[number].success
        if not begun:
            assert run.ended[number].error is not None
            assert run.ended[number].error.facts == {"command": number}
            assert number in run.cancelled
            continue
        written = {**net.transitions, **far.transitions}
        mine = [name for name in duties[symbol] if not isinstance(written[name].action, RequestAction)]
        assert sorted(run.done.get(number, [])) == sorted(mine)
        assert run.ended[number].success
        told = {name: value for name, value in run.ended[number].results.items() if name != "number"}
        assert told == dict.fromkeys(mine, number)
        assert run.ended[number].results.get("number", number) == number
    assert not any(executor.busy() for executor in run.nets().values())


class Mortal:
    """The two nets in two processes with journals, which are killed and come back."""

    def __init__(self, dice: random.Random) -> None:
        self.dice, self.now = dice, 0.0
        self.near, self.far, self.duties = nets_of(dice, ("act",))
        self.wrong: list[str] = []
        self.ended: dict[int, CommandResult] = {}
        self.flying: list[tuple[str, str]] = []
        self.files = {name: MemoryFiles(name) for name in ("near", "far")}
        self.alive = {name: self.start(name) for name in self.files}

    def act(self, ctx: ActionContext) -> None:
        number = ctx.command.id
        if ctx.command.arguments != {"number": number} or any(value != number for value in ctx.result.values()):
            self.wrong.append(f"{ctx.transition} for {ctx.command} with {ctx.result}")
        ctx.result[ctx.transition] = number
        if self.dice.random() < 0.2:
            raise ImError("broke", command=number)

    def passes(self, ctx: ActionContext) -> None:
        if ctx.command.arguments != {"number": ctx.command.id}:
            self.wrong.append(f"{ctx.transition} for {ctx.command}")

    def start(self, name: str) -> JournalledProcess:
        actions = {"act": self.act, **dict.fromkeys(("mend", "goes_on", "is_off"), self.passes)}
        process = JournalledProcess(
            name,
            [self.near if name == "near" else self.far],
            self.files[name],
            actions=actions,
            nodes={"n": "near", "m": "far"},
            transmit=lambda node, packet: self.flying.append((node, packet)),
            clock=lambda: self.now,
            compact_bytes=self.dice.choice((0, 2000, 10**9)),
        )
        if name == "near":
            for job in process.exchange.nets["n"].jobs():
                job.on_closed = partial(self.ended.__setitem__, job.command.id)
        return process

    def do(self, name: str, what: Callable[[JournalledProcess], object]) -> None:
        """Has a process do something; it may die of it, in the middle of writing its journal."""
        try:
            what(self.alive[name])
        except MemoryFiles.Death:
            self.kill(name)

    def kill(self, name: str) -> None:
        self.files[name] = self.files[name].reborn()
        self.alive[name] = self.start(name)

    def under_way(self) -> set[int]:
        return {job.command.id for job in self.alive["near"].exchange.nets["n"].jobs()}

    def command(self, number: int) -> None:
        command = Command(number, self.dice.choice(["go", "run"]), {"number": number}, scope=f"near/{number}")
        while number not in self.ended and number not in self.under_way():
            self.alive["near"].exchange.nets["n"].command(command, partial(self.ended.__setitem__, number))
            self.do("near", JournalledProcess.turn)

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.05
            for name in self.alive:
                self.do(name, JournalledProcess.tick)
            flying, self.flying = self.flying, []
            for node, packet in flying:
                self.do(node, lambda process, packet=packet: process.link.hear(packet))


@pytest.mark.parametrize("seed", range(30))
def test_work_in_another_process_stays_its_commands_when_either_is_killed(seed):
    dice = random.Random(seed)
    world = Mortal(dice)
    torn = seed % 2 == 0
    for number in range(1, 6):
        world.command(number)
        for _ in range(3):
            world.run(dice.choice((0.05, 0.1, 0.3)))
            name = dice.choice(["near", "far"])
            if torn:
                world.files[name].dies_after(dice.randint(0, 3), dice.random())
            else:
                world.kill(name)
    for files in world.files.values():
        files.dies_after(10**9)
    world.run(10.0)
    assert not world.wrong
    assert sorted(world.ended) == [1, 2, 3, 4, 5]
    for number, result in world.ended.items():
        assert result.success
        assert set(result.results.values()) <= {number}
        if not torn:  # else nobody can tell of an action in whose midst the process died
            assert set(result.results) in [set(duties) for duties in world.duties.values()]
    assert not any(executor.busy() for p in world.alive.values() for executor in p.exchange.nets.values())


NEAR = """
net: n
places: {idle: 1, window: {tokens: 1, remote: true}, out: , back: {remote: true}, other: }
transitions:
  go: {symbol: go, in: [idle, window], out: [m.there]}
  end: {in: back, out: idle, emit: go_done}
"""
FAR = """
net: m
places: {there: {remote: true}, done: , bad: , lot: {remote: true, resource: true}}
transitions:
  work: {in: there, out: [done, n.window], action: work, on_failure: bad}
  home: {in: done, out: n.back}
  fail: {in: bad, out: [n.window], emit: go_failed}
"""


def two_nodes(near: str, far: str, actions: dict[str, Callable[..., object]]) -> tuple[Run, Process, Process]:
    run = Run.__new__(Run)
    run.nodes, run.flying = {}, []
    for name, text in (("near", near), ("far", far)):
        run.nodes[name] = Process([parse_net(text)], actions, name=name, transport=Wire(name, run.nodes, run.flying))
    return run, run.nodes["near"], run.nodes["far"]


def test_a_credit_that_comes_back_is_nobodys_and_what_is_emitted_abroad_ends_the_command():
    run, near, far = two_nodes(NEAR, FAR, {"work": hold})
    assert "window" in resource_places(parse_net(NEAR))
    first = near.command("n", "go", part="a")
    run.pump()
    ((owner, activity, ctx),) = run.held()
    assert (ctx.command.id, ctx.command.arguments) == (first, {"part": "a"})
    near.exchange.nets["n"].post(CommandCancelled(first, ImError("enough", code="cancelled")))
    run.pump()
    assert activity.cancelled
    far.held.clear()
    ctx.result["found"] = 1
    owner.ended(activity, ImError("stopped", code="cancelled"))
    run.pump()
    (result,) = near.results
    assert not result.success
    assert (str(result.error), result.results) == ("stopped", {"found": 1})
    assert near.marking("n") == {"window": 1}
    assert not far.exchange.nets["m"].busy()


def test_an_abandoned_command_ends_in_the_net_that_has_its_tokens():
    run, near, far = two_nodes(NEAR, FAR, {"work": hold})
    number = near.command("n", "go")
    run.pump()
    ((_, activity, _),) = run.held()
    (job,) = near.exchange.nets["n"].jobs()
    error = abandonment(near.exchange.nets.values(), job.command, "abandoned by the operator")
    assert error.facts["held"] == ["tokens in net m"]
    near.exchange.nets["n"].post(CommandCancelled(number, error))
    run.pump()
    assert [each.error for each in near.results] == [error]
    assert activity.cancelled
    assert not far.exchange.nets["m"].busy()
    assert far.exchange.nets["m"].at_rest()
    assert not near.exchange.partners()
    (told,) = far.recorder.troubles
    assert told.startswith("command go is abandoned by the operator; ")
    assert "function work of m.work" in told


def test_a_command_whose_tokens_are_lost_with_another_node_fails_and_says_why():
    run, near, far = two_nodes(NEAR, FAR, {"work": hold})
    near.command("n", "go")
    run.pump()
    assert near.exchange.partners() == {"far"}
    near.exchange.node_lost("far", "far is missing")
    far.exchange.node_lost("near", "near is missing")
    run.pump()
    assert [str(result.error) for result in near.results] == ["far is missing"]
    assert run.held()[0][1].cancelled
    assert not far.exchange.nets["m"].jobs()


def test_a_paused_command_begins_nothing_in_another_net_either():
    far_text = (
        FAR.replace("in: there,", "in: [there, on],")
        .replace("there: {", "on: , there: {")
        .replace("transitions:", "transitions:\n  turn_on: {symbol: turn_on, out: on}")
    )
    run, near, far = two_nodes(NEAR, far_text.replace("on: ,", "on: {resource: true},"), {"work": lambda ctx: None})
    number = near.command("n", "go")
    run.pump()
    near.exchange.nets["n"].post(CommandHeld(number, True))
    run.pump()
    far.command("m", "turn_on")
    run.pump()
    assert far.marking("m") == {"there": 1, "on": 1}
    near.exchange.nets["n"].post(CommandHeld(number, False))
    run.pump()
    assert [result.success for result in near.results] == [True]


def consumers(net: Net, place: str) -> list[str]:
    return [t.name for t in net.transitions.values() if place in t.inputs]


ZONE = """
net: n
places: {zone: 1, wanted: , inside: , outside: , trouble: }
transitions:
  begin: {symbol: go, out: wanted}
  enter: {in: [wanted, zone], out: inside}
  leave: {in: inside, out: [outside, zone], action: leave, on_failure: [trouble, zone]}
  work: {in: outside, out: trouble, action: work, on_failure: trouble}
  tell: {in: trouble, emit: go_done}
"""


def test_a_zone_that_one_command_gives_back_is_the_others_while_the_first_goes_on():
    process = Process([parse_net(ZONE)], {"leave": lambda ctx: None, "work": hold})
    first, second = process.command("n", "go"), process.command("n", "go")
    assert [ctx.command.id for _, _, ctx in process.held] == [first, second]
    process.exchange.nets["n"].post(CommandCancelled(first, ImError("enough")))
    process.pump()
    assert [activity.cancelled for _, activity, _ in process.held] == [True, False]
    process.held[0][2].result["mine"] = first
    process.end("work", ImError("cancelled"))
    assert process.held[0][2].last_failure is None
    process.end("work")
    assert [result.results for result in process.results] == [{"mine": first}, {}]


@pytest.mark.parametrize(
    ("places", "arcs", "resources"),
    [
        ("zone: 1, a: , b: ", "{in: [a, zone], out: b}, back: {in: b, out: zone}", {"zone"}),
        ("zone: 2, a: , b: ", "{in: {a: 1, zone: 2}, out: b}, back: {in: b, out: {zone: 2}}", {"zone"}),
        ("zone: 1, a: , b: ", "{in: [a, zone], out: b}, back: {in: b, out: zone}, m: {in: b, out: [b, zone]}", set()),
        ("idle: 1, a: , b: ", "{in: [a, idle], out: b}, again: {in: b, out: idle}, on: {in: idle, out: idle}", set()),
        ("zone: {tokens: 1, resource: false}, a: , b: ", "{in: [a, zone], out: b}, back: {in: b, out: zone}", set()),
        ("zone: {resource: true}, a: , b: ", "{in: [a, zone], out: b}, more: {in: b, out: [b, zone]}", {"zone"}),
        ("in_a: 1, in_b: 1, a: , b: ", "{in: [a, in_a], out: [b, in_b]}, t: {in: [b, in_b], out: [in_a]}", {"in_a"}),
    ],
)
def test_a_resource_is_what_comes_back_and_tells_nobody_whom_to_work_for(places, arcs, resources):
    text = f"net: n\nplaces: {{{places}}}\ntransitions: {{begin: {{symbol: go, out: a}}, take: {arcs}}}"
    assert resource_places(parse_net(text)) == resources


def test_a_firing_that_needs_tokens_of_several_commands_waits_until_they_have_ended():
    net = parse_net(
        """
net: n
places: {a: , ready: , b: }
transitions:
  begin: {symbol: go, out: [a, ready]}
  pair: {in: {a: 2}, out: b}
  tell: {in: ready, emit: go_done, guard: told}
"""
    )
    told = [False]
    process = Process([net], guards={"told": lambda ctx: told[0]})
    process.command("n", "go")
    process.command("n", "go")
    assert process.marking("n") == {"a": 2, "ready": 2}
    told[0] = True
    process.exchange.nets["n"].post(GuardsChanged())
    process.pump()
    assert process.marking("n") == {"b": 1}
    assert [result.success for result in process.results] == [True, True]


def test_a_symbol_that_is_read_for_a_command_leaves_the_command_what_it_was():
    net = parse_net(
        """
net: n
places: {idle: 1, asked: , going: }
transitions:
  begin: {symbol: move, in: idle, out: asked}
  confirm: {symbol: confirm, in: asked, out: going, action: go, on_failure: asked}
  tell: {in: going, out: idle, emit: move_done}
"""
    )
    process = Process([net], {"go": hold})
    moved, _ = process.command("n", "move", by=0.5), process.command("n", "confirm")
    (_, activity, ctx) = process.held[0]
    assert ctx.command.arguments == {"by": 0.5}
    assert [result.success for result in process.results] == [True]  # that of the word, which was read
    process.exchange.nets["n"].post(CommandCancelled(moved, ImError("enough")))
    process.pump()
    assert activity.cancelled
    process.end("confirm")
    assert [result.success for result in process.results] == [True, True]


CONFIRMED = """
net: n
places: {idle: 3, asked: , going: }
transitions:
  begin: {symbol: move, in: idle, out: asked}
  confirm: {symbol: {name: confirm, of: command}, in: asked, out: going, guard: open}
  tell: {in: going, out: idle, action: tell, emit: move_done, on_failure: going}
"""


class Confirmed:
    """Commands that wait to be confirmed."""

    def __init__(self, text: str = CONFIRMED) -> None:
        self.open = True
        self.told: list[int] = []
        self.process = Process(
            [parse_net(text)],
            {"tell": lambda ctx: self.told.append(ctx.command.id)},
            {"open": lambda ctx: self.open},
            clock=Clock(),
        )

    def errors(self) -> list[str]:
        return [str(result.error) for result in self.process.results if result.error is not None]


def test_a_word_is_for_the_command_that_it_names_and_for_the_oldest_where_it_names_none():
    run = Confirmed()
    first, second, third = (run.process.command("n", "move") for _ in range(3))
    run.process.command("n", "confirm", command=second)
    assert run.told == [second]
    run.process.command("n", "confirm")
    run.process.command("n", "confirm")
    assert run.told == [second, first, third]
    assert run.errors() == []
    assert len(run.process.results) == 6


def test_a_word_begins_no_command_and_waits_for_one_that_asks():
    run = Confirmed()
    run.process.command("n", "confirm")
    assert run.process.results == []
    moved = run.process.command("n", "move")
    assert run.told == [moved]


def test_a_word_to_a_command_that_has_ended_or_never_was_is_refused():
    run = Confirmed()
    first = run.process.command("n", "move")
    run.process.command("n", "confirm", command=7)
    assert run.errors() == ["confirm is for command 7, which is not under way"]
    run.open = False
    run.process.command("n", "confirm", command=first)
    run.open = True
    run.process.command("n", "confirm")  # the one before is read first, and this one waits
    assert run.told == [first]
    run.process.command("n", "confirm", command=first)
    assert run.errors()[1:] == [f"confirm is for command {first}, which is not under way"]


@pytest.mark.parametrize(("expires", "limit"), [(0, "before the net came to rest"), (2, "within 2 s")])
def test_a_symbol_that_nobody_has_asked_for_expires(expires, limit):
    run = Confirmed(CONFIRMED.replace("of: command", f"of: command, expires: {expires}"))
    run.process.command("n", "confirm")
    run.process.wait(1.0)
    assert len(run.errors()) == (expires == 0)
    run.process.wait(1.5)
    assert run.errors() == [f"nothing has asked for confirm {limit}"]
    run.process.command("n", "move")
    assert run.told == []
    run.process.command("n", "confirm")
    assert len(run.told) == 1


def test_a_symbol_that_is_asked_for_waits_though_its_guard_is_closed():
    run = Confirmed(CONFIRMED.replace("of: command", "of: command, expires: 0"))
    run.open = False
    moved = run.process.command("n", "move")
    run.process.command("n", "confirm")
    run.open = True
    run.process.exchange.nets["n"].post(GuardsChanged())
    run.process.pump()
    assert run.told == [moved]


def test_a_symbol_of_nobody_begins_no_command():
    net = parse_net(
        "net: n\nplaces: {dark: 1, light: }\n"
        "transitions: {on: {symbol: {name: press, of: nobody}, in: dark, out: light, action: f, on_failure: dark}}"
    )
    seen: list[int] = []
    process = Process([net], {"f": lambda ctx: seen.append(ctx.command.id)})
    process.command("n", "press")
    assert seen == [0]
    assert [result.success for result in process.results] == [True]


def test_all_that_read_a_symbol_say_the_same_of_it():
    with pytest.raises(NetFileError, match="says of 'confirm' something else than transition 'confirm' does"):
        parse_net(f"{CONFIRMED}  again: {{symbol: confirm, in: going, out: asked}}\n")


def test_a_journal_brings_words_back():
    run = Confirmed(CONFIRMED.replace("of: command", "of: command, expires: 2"))
    executor = run.process.exchange.nets["n"]
    entries: list[str] = []
    encode = NET_ENTRY.encode
    executor.rule.record = lambda entry: entries.append(encode(entry))
    for step in ("confirm", "move", "move", "move"):
        run.process.command("n", step)
    run.process.command("n", "confirm", command=3)
    run.process.command("n", "confirm", command=2)
    run.open = False
    run.process.command("n", "confirm", command=4)
    run.process.wait(3.0)
    again = Process([executor.written], run.process.functions.actions, {"open": lambda ctx: False})
    replayed = again.exchange.nets["n"]
    for text in entries:
        replayed.replay(NET_ENTRY.decode(json.loads(text)))
    replayed.rule.record = executor.record
    assert net_state(replayed) == net_state(executor)
