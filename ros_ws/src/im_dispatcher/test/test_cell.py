"""What commands take of the cell: the net, the line, and that many commands at once end each with its own result."""

import functools
import random

import pytest

from im_cell.robot import load_cell
from im_core.errors import ImError, NotFoundError, StateError
from im_dispatcher.cell.needs import Needs, resources_of
from im_dispatcher.cell.net import cell_net
from im_dispatcher.cell.queue import WaitingLine, reason
from im_pnt.errors import NetError
from im_pnt.execution.events import CommandCancelled, CommandHeld
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Command, CommandResult
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_node.journal.state import restore_net, taken_over
from support.process import Process, hold

NET = """
net: {name}
commands:
  {name}:
    needs: [{needs}]
    priority: {priority}
    arguments: {{side: {{type: string, choices: [left, right], default: left}}, of: {{type: integer, default: 0}}}}
places: {{idle: {{tokens: 9, resource: true}}, one: , two: , missed: , trouble: }}
transitions:
  one: {{symbol: {name}, in: idle, out: one, action: work, on_failure: missed}}
  two: {{in: one, out: two, action: work, on_failure: missed}}
  tell: {{in: two, out: trouble, action: tell, on_failure: trouble}}
  done: {{in: trouble, out: idle, emit: {name}_done}}
  failed: {{in: missed, out: idle, emit: {name}_failed}}
"""
RESOURCES = ("left_arm", "right_arm", "camera", "light", "zone")


def a_net(name: str, needs: str, priority: int = 0) -> str:
    return NET.format(name=name, needs=needs, priority=priority)


@functools.cache
def made_of(*texts: str) -> tuple[list[Net], Needs, Net]:
    nets = [parse_net(text) for text in texts]
    needs = Needs(nets, RESOURCES)
    return nets, needs, cell_net(needs)


def test_a_symbol_begins_a_command_of_one_net_only():
    text = (
        "net: {0}\nplaces: {{a: 1, b: }}\ntransitions: {{go: {{symbol: {1}, in: a, out: b}}, back: {{in: b, out: a}}}}"
    )
    word = "{name: confirm, of: command}"
    Needs([parse_net(text.format(name, word)) for name in ("one", "other")], RESOURCES)
    with pytest.raises(NetError, match=r"^nets one \(net\) and other \(net\) both have the command go$"):
        Needs([parse_net(text.format(name, "go")) for name in ("one", "other")], RESOURCES)


class Cell:
    """Commands over a cell, whose actions a test ends by hand.

    Attributes:
        results: How commands have ended, by number.
        begun: Numbers of the commands in the order in which they began.
    """

    def __init__(self, texts: list[str]) -> None:
        nets, self.needs, self.net = made_of(*texts)
        self.line = WaitingLine(self.needs, lambda: self.executor)
        self.process = Process([self.net, *nets], {"work": hold, "tell": self.tell}, self.line.guards())
        self.executor = self.process.exchange.nets["cell"]
        self.results: dict[int, CommandResult] = {}
        self.begun: list[int] = []
        self._count = 0

    def tell(self, ctx: ActionContext) -> None:
        ctx.result["number"], ctx.result["of"] = ctx.command.id, ctx.request_arguments["of"]

    def run(self, symbol: str, priority: int = 0, **arguments: object) -> int:
        self._count += 1
        number = self._count
        declared = self.needs.variant(symbol, {"side": "left", **arguments}).declared
        command = Command(number, symbol, {"of": number, **arguments}, declared.priority + priority)
        self.executor.command(command, lambda result: self.results.__setitem__(number, result))
        self.pump()
        return number

    def post(self, event: object) -> None:
        for executor in self.process.exchange.nets.values():
            executor.post(event)
        self.pump()

    def end(self, number: int, error: ImError | None = None) -> None:
        held = next(held for held in self.process.held if held[2].command.id == number)
        self.process.held.remove(held)
        held[0].ended(held[1], error)
        self.pump()

    def pump(self) -> None:
        """Lets the nets go on; whoever runs holds all that it needs, and nobody else does."""
        self.process.pump()
        running = self.line.running()
        taken = [need for claim in running for need in claim.variant.needs]
        assert len(taken) == len(set(taken))
        marking = self.executor.marking()
        assert {name for name in RESOURCES if marking.get(name)} == set(RESOURCES) - set(taken)
        self.begun += [s.command.id for s in running if s.command.id not in self.begun]

    def working(self) -> set[int]:
        return {ctx.command.id for _, _, ctx in self.process.held}


def test_commands_run_at_once_unless_they_need_the_same():
    cell = Cell([a_net("move", '"${arguments.side}_arm"'), a_net("look", "camera, light")])
    left, behind, right = cell.run("move"), cell.run("move"), cell.run("move", side="right")
    look = cell.run("look")
    assert cell.working() == {left, right, look}
    asking = cell.line.claim(Command(9, "move", {"side": "left"}))
    assert reason(asking, cell.line.keepers(asking)) == (
        f"move needs left_arm, which move (number {left}) has; left_arm, which move (number {behind}) waits for"
    )
    cell.end(left)
    cell.end(left)
    assert cell.working() == {behind, right, look}
    assert cell.results[left].results == {"number": left, "of": left}


@pytest.mark.parametrize("how", ["failure", "cancel", "cancel of one that waits"])
def test_what_was_taken_is_given_back_however_a_command_ends(how):
    cell = Cell([a_net("a", "camera, zone"), a_net("b", "zone")])
    first, second = cell.run("a"), cell.run("b")
    off = ImError("enough", code="cancelled")
    if how == "failure":
        cell.end(first, ImError("no", code="no"))
        assert cell.results[first].error.code == "no"
    elif how == "cancel":
        cell.post(CommandCancelled(first, off))
        cell.end(first, off)
        assert cell.results[first].error.code == "cancelled"
    else:
        cell.post(CommandCancelled(second, off))
        assert cell.results[second].error.code == "cancelled"
        cell.end(first)
        cell.end(first)
        second = cell.run("b")
    assert cell.working() == {second}


def test_who_needs_several_things_is_not_overtaken_for_ever_by_those_who_need_one():
    cell = Cell([a_net("both", "left_arm, right_arm"), a_net("move", '"${arguments.side}_arm"')])
    left, right = cell.run("move"), cell.run("move", side="right")
    both = cell.run("both")
    later = [cell.run("move", side=side) for side in ("left", "right", "left")]
    for number in (left, left, right, right):
        cell.end(number)
    assert cell.working() == {both}
    cell.end(both)
    cell.end(both)
    assert cell.working() == set(later[:2])


def test_a_step_of_priority_is_worth_ten_places_in_the_line():
    cell = Cell([a_net("low", "zone"), a_net("high", "zone", priority=1)])
    busy, low = cell.run("low"), cell.run("low")
    high = [cell.run("high") for _ in range(12)]
    order = []
    while cell.working():
        (number,) = cell.working()
        order.append(number)
        cell.end(number)
        cell.end(number)
    assert order == [busy, *high[:9], low, *high[9:]]


def test_random_schedules_of_6_commands_end_each_with_its_own_result():
    """No deadlock, no mix-up, nobody starved: whatever is ended, cancelled, failed, paused or resumed, and when."""
    dice = random.Random(13)
    overtaken, cells = 0, [Cell(some_nets(dice)) for _ in range(20)]
    for _ in range(200):
        cell = dice.choice(cells)
        cell.results.clear()
        cell.begun.clear()
        names = sorted({variant.symbol for variant in cell.needs.variants.values()})
        fate: dict[int, str] = {}
        paused: set[int] = set()
        while len(cell.results) < 6:
            number = dice.choice([*fate, 0])
            match dice.choice(["run", "run", "end", "end", "end", "fail", "cancel", "pause", "resume"]):
                case "run" if len(fate) < 6:
                    side = dice.choice(["left", "right"])
                    fate[cell.run(dice.choice(names), dice.choice([0, 0, 0, 1, -1]), side=side)] = "done"
                case "end" if cell.working():
                    cell.end(dice.choice(sorted(cell.working())))
                case "fail" if cell.working():
                    number = dice.choice(sorted(cell.working()))
                    fate[number] = "no"
                    cell.end(number, ImError("no", code="no"))
                case "cancel" if number and number not in cell.results and number not in paused:
                    if number not in cell.begun:
                        fate[number] = "cancelled"
                    cell.post(CommandCancelled(number, ImError("enough", code="cancelled")))
                case "pause" if number and number not in cell.results:
                    paused.add(number)
                    cell.post(CommandHeld(number, True))
                case "resume" if paused:
                    number = dice.choice(sorted(paused))
                    paused.discard(number)
                    cell.post(CommandHeld(number, False))
            unpaused = set(fate) - set(cell.results) - paused
            if unpaused and not paused:
                assert cell.working(), "commands are left, and none of them goes on"
        for number, result in cell.results.items():
            if fate[number] == "done":
                assert result.results == {"number": number, "of": number}
            else:
                assert result.error is not None
                assert result.error.code == fate[number]
                assert not result.results
        assert {name: cell.executor.marking().get(name) for name in RESOURCES} == dict.fromkeys(RESOURCES, 1)
        overtaken += cell.begun != sorted(cell.begun)
    assert overtaken > 20  # the schedules do something


def some_nets(dice: random.Random) -> list[str]:
    texts = []
    for name in ("a", "b", "c"):
        needs = dice.sample(RESOURCES, dice.randint(1, 3))
        if dice.random() < 0.5:
            needs = [need for need in needs if not need.endswith("_arm")] + ['"${arguments.side}_arm"']
        texts.append(a_net(name, ", ".join(needs), dice.choice([0, 0, 2])))
    return texts


def test_the_net_of_the_cell_is_replaced_while_commands_run_and_wait():
    move, look = a_net("move", '"${arguments.side}_arm"'), a_net("look", "camera, light")
    cell = Cell([move])
    left, behind = cell.run("move"), cell.run("move")
    both, needs, net = made_of(move, look)
    cell.line.require_same(needs)
    cell.line = WaitingLine(needs, lambda: cell.executor)
    cell.process.functions.guards.update(cell.line.guards())
    exchange = cell.process.exchange
    for each in (both[1], net):
        executor = Executor(each, cell.process.functions, cell.process, exchange, cell.process.recorder)
        if each is net:
            restore_net(executor, taken_over(cell.executor, net))
            exchange.succeed(executor)
        else:
            exchange.add(executor)
    cell.executor, cell.needs = executor, needs
    for job in executor.jobs():
        job.on_closed = functools.partial(cell.results.__setitem__, job.command.id)
    executor.resume()
    third = cell.run("look")
    assert cell.working() == {left, third}
    cell.end(left)
    cell.end(left)
    assert cell.results[left].results == {"number": left, "of": left}
    assert cell.working() == {behind, third}
    with pytest.raises(StateError, match=f"look \\(number {third}\\) has not ended: no net would know it"):
        cell.line.require_same(made_of(move)[1])
    with pytest.raises(StateError, match="look is under way"):
        taken_over(executor, made_of(move)[2])


def test_the_net_of_the_cell_is_verified_alone_and_with_those_that_do_the_commands():
    texts = [a_net("move", '"${arguments.side}_arm", "${arguments.side}_arm"'), a_net("look", "camera, light")]
    cell = Cell(texts)
    report = verify_to_load([cell.net])
    report.require_ok()
    assert cell.net.places["left_arm"].resource
    assert cell.net.transitions["move_left"].inputs == {"left_arm": 1}


@pytest.mark.parametrize(
    ("needs", "error", "message"),
    [
        ("left_arn", NotFoundError, "did you mean 'left_arm'"),
        ('"${arguments.sid}_arm"', NotFoundError, "did you mean 'side'"),
        ('"${arguments.of}"', NetError, "argument of decides what is needed"),
    ],
)
def test_a_command_that_needs_what_there_is_not_is_refused_by_name(needs, error, message):
    with pytest.raises(error, match=message):
        Cell([a_net("move", needs)])


def test_the_cell_has_each_arm_cart_gripper_light_camera_the_laser_and_the_zone():
    assert resources_of(load_cell()) == (
        *("left_arm", "left_gripper", "left_led"),
        *("right_arm", "right_gripper", "right_led"),
        *("ceiling_left", "ceiling_right", "wall", "table", "wrist_left", "laser", "zone"),
    )
