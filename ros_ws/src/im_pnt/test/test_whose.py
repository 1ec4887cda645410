"""Whose work a token is: commands that meet in one net do not touch each other.

Random nets run many commands over shared resources, forks, joins, failures and requests. What a command has to do is
known from how its net was made: whether it did that, all of it and nothing else, shows whose its tokens were.
"""

import json
import random
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.errors import NetFileError
from im_pnt.execution.events import CommandCancelled, GuardsChanged
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Activity, Command, CommandResult
from im_pnt.journal.codec import decode_net_entry, net_encoder
from im_pnt.journal.state import net_state
from im_pnt.model.action import FunctionAction, RequestAction
from im_pnt.model.net import Guard, Net, Place, Transition
from im_pnt.model.resources import resource_places
from im_pnt.netfile import parse_net
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

    def place(self, name: str) -> str:
        self.places[name] = Place(name)
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

    def choice(self, here: str, there: str, tool: str) -> None:
        for name, guard, action in (("on", Guard("cancelled", negated=True), "goes_on"), ("off", CANCELLED, "is_off")):
            self.transition(
                f"{here}_{name}", [here, tool], [there, tool], action, guard=guard, on_failure={there: 1, tool: 1}
            )


def a_net(dice: random.Random) -> tuple[Net, dict[str, dict[str, int]]]:
    """Nets in which commands do one thing after the other, and some with a tool that all of them share."""
    made, kinds = Made(), ["act", "hold", "hold", "hold", "ask"]
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
            match dice.choice(["step", "passing", "holding", "fork", "choice"]):
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
    return Net("n", made.places, made.transitions), made.duties


class Run:
    """Commands in a net; whatever an action is told is checked to be of its own command."""

    def __init__(self, net: Net, duties: dict[str, dict[str, int]], seed: int) -> None:
        self.duties = duties
        self.wrong: list[str] = []
        self.done: dict[int, list[str]] = {}
        self.asked: dict[int, str] = {}
        self.ended: dict[int, CommandResult] = {}
        self.cancelled: set[int] = set()
        self.told: list[int] = []
        self.heard: set[Activity] = set()
        actions = {each.__name__: each for each in (self.act, self.mend, self.serve, self.goes_on, self.is_off)}
        actions["hold"] = hold
        self.process = Process([net, SERVERS[seed % len(SERVERS)]], actions, seed=seed)
        self.entries: dict[str, list[str]] = {"n": [], "server": []}
        for name, executor in self.process.exchange.nets.items():
            encode, entries = net_encoder(name), self.entries[name]
            executor.rule.record = lambda entry, encode=encode, entries=entries: entries.append(encode(entry))

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
            order=all(name in (*done, *ctx.replies) for name in stages if stages[name] < stages[ctx.transition]),
        )
        ctx.result["number"] = ctx.memory["number"] = number
        done.append(ctx.transition)

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
        executor = self.process.exchange.nets["n"]
        job = executor.command(
            Command(number, symbol, {"number": number}),
            lambda result: self.ended.__setitem__(number, result),
        )
        assert job.command.id == number
        self.process.pump()

    def end(self, held: tuple[object, Activity, ActionContext], fails: bool) -> None:
        owner, activity, ctx = held
        self.process.held.remove(held)
        self.does(ctx)
        owner.ended(activity, ImError("no", code="no", command=ctx.command.id) if fails else None)
        self.process.pump()

    def cancel(self, number: int) -> None:
        """A cancel stops exactly the actions of its own command."""
        for _, activity, ctx in self.process.held:
            if activity not in self.heard:
                self.heard.add(activity)
                ctx.on_cancel(lambda whose=ctx.command.id: self.told.append(whose))
        wanted = {n for _, a, c in self.process.held if (n := c.command.id) == number and not a.cancelled}
        self.told.clear()
        if number not in self.ended:
            self.cancelled.add(number)
        self.process.exchange.nets["n"].post(CommandCancelled(number, ImError("off", code="off", command=number)))
        self.process.pump()
        assert set(self.told) == wanted

    def check(self) -> None:
        """Nobody has seen or done what is another's; a journal tells it the same."""
        assert not self.wrong
        for name, executor in self.process.exchange.nets.items():
            again = Process([executor.written], self.process.functions.actions).exchange.nets[name]
            for text in self.entries[name]:
                again.replay(decode_net_entry(json.loads(text)[2]))
            again.rule.record = executor.record
            assert net_state(again) == net_state(executor)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32))
def test_commands_that_share_a_net_do_not_touch_each_other(seed):
    dice = random.Random(seed)
    net, duties = a_net(dice)
    assert set(TOOLS) <= resource_places(net) | {tool for tool in TOOLS if not consumers(net, tool)}
    run = Run(net, duties, seed)
    for _ in range(dice.randint(10, 40)):
        match dice.choice(["go", "go", "run", "end", "end", "end", "fail", "cancel"]):
            case ("go" | "run") as symbol if len(run.asked) < 8:
                run.command(symbol)
            case "cancel" if run.asked:
                run.cancel(dice.choice(list(run.asked)))
            case ("end" | "fail") as how if run.process.held:
                run.end(dice.choice(run.process.held), how == "fail")
    run.check()
    while run.process.held:
        run.end(run.process.held[0], False)
    run.check()
    for number, symbol in run.asked.items():
        begun = number in run.done or run.ended[number].success
        if not begun:
            assert run.ended[number].error is not None
            assert run.ended[number].error.facts == {"command": number}
            assert number in run.cancelled
            continue
        mine = [name for name in duties[symbol] if not isinstance(net.transitions[name].action, RequestAction)]
        assert sorted(run.done.get(number, [])) == sorted(mine)
        assert run.ended[number].success
        assert run.ended[number].results.get("number", number) == number


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


@pytest.mark.parametrize("expires", [0, 2])
def test_a_symbol_that_nobody_has_asked_for_expires(expires):
    run = Confirmed(CONFIRMED.replace("of: command", f"of: command, expires: {expires}"))
    run.process.command("n", "confirm")
    run.process.wait(1.0)
    assert len(run.errors()) == (expires == 0)
    run.process.wait(1.5)
    assert run.errors() == ["nothing has asked for confirm in time"]
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
    encode = net_encoder("n")
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
        replayed.replay(decode_net_entry(json.loads(text)[2]))
    replayed.rule.record = executor.record
    assert net_state(replayed) == net_state(executor)
