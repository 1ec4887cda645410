"""What is done for a command while it runs is within what it needs: the shipped nets, played by the engine itself."""

import random
from collections.abc import Callable, Coroutine

from im_cell.robot import load_cell
from im_core.config import package_file
from im_core.errors import ImError
from im_dispatcher import commands
from im_dispatcher.cell.needs import Needs, resources_of
from im_dispatcher.cell.net import NAME, cell_net
from im_dispatcher.cell.queue import WaitingLine
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Activity
from im_pnt.execution.values import run_at_once
from im_pnt.expression.template import OPENS
from im_pnt.model.action import GoalAction, ServiceAction, TopicAction
from im_pnt.model.arguments import ArgumentSchema
from im_pnt.netfile import load_net
from support.process import Process

CALIBRATION = {"observations": [1], "directory": "results"}


class StoredObjects(dict[str, object]):
    """Data objects in memory, read at once."""

    async def read(self, name: str, kind: str, ways: object) -> object:
        return self.latest(name, kind, ways)

    def latest(self, name: str, kind: str, ways: object) -> object:
        if name not in self:
            raise ImError(f"there is no data object {name}")
        return self[name]

    def stale(self) -> None:
        pass

    async def put(self, name: str, kind: str, fields: object, place: str = "") -> None:
        self[name] = fields

    def run(self, work: Coroutine[object, object, None], done: Callable[[ImError | None], None]) -> None:
        run_at_once(work, done)


class Played:
    """The nets of the Dispatcher and of the Coordinators; what they tell the world succeeds or fails by dice.

    Attributes:
        asked: The arguments of the commands, with their symbols, by number.
        done: What was acted on for whom: transition, number of the command, resource.
    """

    def __init__(self, dice: random.Random) -> None:
        self.dice = dice
        self.asked: dict[int, tuple[str, dict[str, object]]] = {}
        self.done: set[tuple[str, int, str]] = set()
        nets = [load_net(file) for file in commands.net_files(commands.shipped())]
        self.needs = Needs(nets, resources_of(load_cell()))
        coordinators = package_file("im_coordinators", "nets/motion_coordinator.yaml").parent.glob("*.yaml")
        self.nets = {net.name: net for net in (cell_net(self.needs), *nets, *map(load_net, sorted(coordinators)))}
        line = WaitingLine(self.needs, lambda: self.process.exchange.nets[NAME])
        guards = {name: self.toss for net in self.nets.values() for name in net.guards() if OPENS not in name}
        actions = {name: self.made for net in self.nets.values() for name in net.functions()}
        world = dict.fromkeys((ServiceAction, GoalAction, TopicAction), self.tell)
        self.process = Process(
            [*self.nets.values()], actions, {**guards, **line.guards()}, others=world, objects=StoredObjects()
        )

    def toss(self, _: ActionContext) -> bool:
        return self.dice.random() < 0.5

    def fail(self) -> None:
        if self.dice.random() < 0.15:
            raise ImError("no", code=self.dice.choice(["no", "begun_anew", "collision", "link", "spot_too_faint"]))

    def made(self, ctx: ActionContext) -> dict[str, object]:
        """Returns what a function of the nets that makes the arguments of a request could."""
        self.fail()
        asked, group = ctx.request_arguments, ctx.request_arguments.get("group", "left")
        match ctx.transition:
            case "plan_path" | "plan_in_turn":
                return {"group": group, "joints": [0.0] * 9}
            case "validate_path":
                return {"group": group, "path": asked["path"]}
            case "plan_ahead.plan":
                return {"joints": [0.0] * 9}
            case "move_robot":
                return {"planned": self.toss(ctx)}
            case "look" | "find_spot":
                return {"cameras": self.dice.sample(["ceiling_left", "wall", "table"], 2), "light": f"{group}_led"}
            case "keep_observation.keep" | "keep_observation.keep_last":
                return {"number": 1, "pose": "first"}
            case "compute_calibration":
                return {**CALIBRATION, "group": group, "cameras": ["wall"]}
        return {}

    async def tell(self, activity: Activity, ctx: ActionContext) -> dict[str, object]:
        """Stands for the world, and notes what was acted on: as the net file says, with the arguments as they are."""
        transition = self.nets[activity.net].transitions[activity.transition]
        for text in transition.acts_on or ():
            before, _, rest = text.partition("${arguments.")
            name, _, after = rest.partition("}")
            value = ctx.request_arguments[name] if name else ""
            for each in value if isinstance(value, list) else [value]:
                self.done.add((f"{activity.net}.{activity.transition}", ctx.command.id, f"{before}{each}{after}"))
        self.fail()
        if transition.strategy is not None and transition.strategy.successes > 1.0 and self.dice.random() < 0.9:
            raise ImError("no", code="no")  # so often that the other ways are tried first, too
        answer = {"stalled": self.toss(ctx), "position": 0.0, "effort": 0.0, "found": self.toss(ctx), "cause": "dark"}
        return {**answer, "look": "7"}

    def run(self, symbol: str) -> None:
        arguments = drawn(self.needs.declared(symbol).arguments, self.dice)
        taken = self.needs.declared(symbol).arguments.check(arguments, symbol)
        number = self.process.command(NAME, symbol, **taken)
        self.asked[number] = symbol, taken


def drawn(schema: ArgumentSchema, dice: random.Random) -> dict[str, object]:
    """Returns arguments of which those that decide something are drawn."""
    drawn = {name: dice.choice(each.choices) for name, each in schema.arguments.items() if each.choices}
    given = {"joints": [0.0] * 9, "position": [0.0] * 3}
    return drawn | {name: value for name, value in given.items() if name in schema.arguments}


def test_what_is_done_for_a_command_is_within_what_it_needs() -> None:
    dice = random.Random(13)
    played = Played(dice)
    symbols = sorted({variant.symbol for variant in played.needs.variants.values()})
    saying = {
        f"{net.name}.{each.name}"
        for net in played.nets.values()
        for each in net.transitions.values()
        if each.acts_on and isinstance(each.action, ServiceAction | GoalAction | TopicAction)
    }
    rounds = 0
    while {transition for transition, _, _ in played.done} != saying:  # until the dice have led everywhere
        rounds += 1
        assert rounds <= 240
        for symbol in symbols:
            played.run(symbol)
    assert len(played.process.results) == len(played.asked)
    for transition, number, resource in played.done:
        held = played.needs.variant(*played.asked[number]).needs
        assert resource in held, f"{transition} acts on {resource} for {played.asked[number]}, which holds {held}"
