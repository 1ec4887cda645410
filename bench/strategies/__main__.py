"""Study of learned strategies: 500 commands in a world that changes, against fixed orders, in the same world.

The world is a model: cameras fog and clear, ways are blocked and opened, objects get slippery and dry again, and a try
succeeds with a probability that depends on that. The choices are those of the product: a net whose strategies contend,
executed by the executor of all nodes, with its book of experience.
"""

import argparse
import io
import itertools
import random
import statistics
import sys
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.figures import Line
from bench.part import Part, Work
from im_core.errors import ImError, StateError
from im_core.files import write_whole
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, Functions, woken_by
from im_pnt.execution.jobs import Command
from im_pnt.execution.notification import Observer, StrategyChosen
from im_pnt.execution.runner import FunctionRunner
from im_pnt.netfile import parse_net
from im_pnt_node.distributed.exchange import Exchange

COMMANDS = 500
SEEDS = range(10)
KEPT = 0.9
"""Decay of the counts at each outcome."""


@dataclass(frozen=True)
class Way:
    """Strategy of the model.

    Attributes:
        name: Its name.
        cost: Time of a try [s].
        well: Probability of success in a world as usual.
        ill: The same where the thing has gone wrong that its step can meet.
    """

    name: str
    cost: float
    well: float
    ill: float


STEPS = {
    "look": (
        "camera",
        ("wall", "floor"),
        (
            Way("usual_exposure", 0.15, 0.97, 0.05),
            Way("longer_exposure", 0.2, 0.9, 0.8),
            Way("other_camera", 0.3, 0.9, 0.9),
        ),
    ),
    "move": (
        "arm",
        ("left", "right"),
        (Way("straight", 3.0, 0.97, 0.03), Way("around", 4.0, 0.93, 0.9), Way("other_elbow", 4.5, 0.9, 0.5)),
    ),
    "grip": (
        "kind",
        ("box", "rod"),
        (Way("soft", 1.0, 0.95, 0.1), Way("firm", 1.1, 0.85, 0.75), Way("from_the_side", 2.0, 0.85, 0.85)),
    ),
}
"""Steps of a command: the argument that is the context, its values, and the ways to do it, in the fixed order."""

GOES_WRONG, COMES_RIGHT = 1.0 / 60.0, 1.0 / 40.0
"""Probabilities that the world changes from one command to the next, for each value of a context."""


@dataclass(frozen=True)
class Task:
    """Command of the study, with all that will happen if it is tried.

    Attributes:
        arguments: Of the command.
        good: Whether a way succeeds, by step and way.
    """

    arguments: Mapping[str, str]
    good: Mapping[tuple[str, str], bool]


def tasks(seed: int, commands: int = COMMANDS) -> list[Task]:
    """Return the commands of a study: the same for every way to choose."""
    dice, made = random.Random(seed), []
    ill: dict[str, bool] = {}
    for _ in range(commands):
        arguments, good = {}, {}
        for step, (argument, values, ways) in STEPS.items():
            for value in values:
                was = ill.get(value, False)
                ill[value] = dice.random() >= COMES_RIGHT if was else dice.random() < GOES_WRONG
            arguments[argument] = dice.choice(values)
            for way in ways:
                good[step, way.name] = dice.random() < (way.ill if ill[arguments[argument]] else way.well)
        made.append(Task(arguments, good))
    return made


def failed_in_order(task: Task, orders: Mapping[str, Sequence[Way]]) -> int:
    """Return how many tries fail for a command that tries the ways of each step in an order."""
    failed = 0
    for step, ways in orders.items():
        failed += next((n for n, way in enumerate(ways) if task.good[step, way.name]), len(ways))
    return failed


def best_orders(made: Sequence[Task]) -> dict[str, tuple[Way, ...]]:
    """Return the order of each step that fails least over all commands, known only in hindsight."""
    return {
        step: min(
            itertools.permutations(ways), key=lambda order: sum(failed_in_order(task, {step: order}) for task in made)
        )
        for step, (_, _, ways) in STEPS.items()
    }


def study_net() -> str:
    """Return the net: each way is tried at most once for a command, and the next one is chosen among those left."""
    names = list(STEPS)
    lines = ["net: study", "commands:", "  go:", "    arguments:"]
    lines += [f"      {argument}: {{type: string}}" for argument, _, _ in STEPS.values()]
    lines += ["places:", "  done:", *(f"  {name}:" for name in names), "transitions:"]
    lines += [f"  begin: {{symbol: go, in: [], out: {names[0]}}}", "  end: {in: done, out: [], emit: go_done}"]
    for step, after in zip(names, [*names[1:], "done"], strict=True):
        argument, _, ways = STEPS[step]
        for way in ways:
            told = f"{{decay: {KEPT}, context: '${{arguments.{argument}}}'}}"
            lines.append(
                f"  {way.name}: {{in: {step}, out: {after}, guard: left_{way.name}, action: {way.name}, "
                f"on_failure: {step}, delay: {way.cost}, strategy: {told}}}"
            )
        lines.append(f"  give_up_{step}: {{in: {step}, out: {after}, guard: none_left_{step}}}")
    return "\n".join(lines) + "\n"


class _Entropy(Observer):
    """Adds the entropies of a command."""

    def __init__(self) -> None:
        self.sum = 0.0

    def chose(self, choice: StrategyChosen) -> None:
        """Adds that of a choice."""
        self.sum += choice.entropy


def learned(made: Sequence[Task], seed: int) -> tuple[list[int], list[float]]:
    """Return how many tries of each command fail where the ways are learned, and the entropy of its choices [nats]."""
    now: list[Task] = []
    failures: list[int] = []

    def attempt(step: str, way: str) -> Callable[[ActionContext], None]:
        def act(ctx: ActionContext) -> None:
            ctx.memory[way] = True
            if not now[-1].good[step, way]:
                failures[-1] += 1
                raise ImError(f"{way} does not work")

        return act

    def untried(way: str) -> Callable[[ActionContext], bool]:
        return woken_by()(lambda ctx: way not in ctx.memory)

    def none_left(ways: Sequence[Way]) -> Callable[[ActionContext], bool]:
        return woken_by()(lambda ctx: all(way.name in ctx.memory for way in ways))

    actions = {way.name: attempt(step, way.name) for step, (_, _, ways) in STEPS.items() for way in ways}
    guards = {f"left_{way.name}": untried(way.name) for _, _, ways in STEPS.values() for way in ways}
    guards |= {f"none_left_{step}": none_left(ways) for step, (_, _, ways) in STEPS.items()}
    functions, observer = Functions(actions, guards), _Entropy()
    exchange = Exchange("bench", 1, None, observer)
    runner = FunctionRunner(functions, exchange, _never)
    executor = Executor(parse_net(study_net()), functions, runner, exchange, observer, seed=seed)
    exchange.add(executor)
    entropies, ended = [], 0

    def end(_: object) -> None:
        nonlocal ended
        ended += 1

    for number, task in enumerate(made, 1):
        now.append(task)
        failures.append(0)
        observer.sum = 0.0
        executor.command(Command(number, "go", dict(task.arguments), scope=f"study/{number}"), end)
        while executor.pump():
            pass
        if ended != number:
            raise StateError(f"command {number} of the study does not end: {executor.marking()}")
        entropies.append(observer.sum)
    return failures, entropies


def _never(work: Coroutine[object, object, None]) -> None:
    work.close()
    raise StateError("nothing in this study waits")


def _measure(plot: Path | None) -> list[Line]:
    counts: dict[str, list[int]] = {"fixed": [], "best": [], "learned": []}
    for seed in SEEDS:
        made = tasks(seed)
        fixed = [failed_in_order(task, {step: ways for step, (_, _, ways) in STEPS.items()}) for task in made]
        best = [failed_in_order(task, best_orders(made)) for task in made]
        tried, entropies = learned(made, seed)
        for name, failed in (("fixed", fixed), ("best", best), ("learned", tried)):
            counts[name].append(sum(failed))
        if plot is not None and seed == SEEDS[0]:
            draw({"fixed order": fixed, "best fixed order": best, "learned": tried}, entropies, plot)
    middle = {name: float(statistics.median(values)) for name, values in counts.items()}
    worst = max(a / b for a, b in zip(counts["learned"], counts["fixed"], strict=True))
    return [
        Line(f"failed tries in {COMMANDS} commands", middle["learned"], "", middle["fixed"], "fixed order", 0.7),
        Line("of the worst seed, share of fixed order", worst, ""),
        Line("regret", middle["learned"] - middle["best"], "", None, "against the best fixed order, in hindsight"),
    ]


def draw(failed: Mapping[str, Sequence[int]], entropies: Sequence[float], path: Path) -> Path:
    """Draws failed tries and regret over the commands, and the entropy of each command's choices.

    Args:
        failed: Failed tries of each command, by the way to choose; ``best fixed order`` is what regret is against.
        entropies: Of each command [nats].
        path: An SVG file.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawing = io.BytesIO()
    best = list(itertools.accumulate(failed["best fixed order"]))
    with rc_context({"svg.hashsalt": "im", "svg.fonttype": "none", "font.size": 8}):
        figure = Figure(figsize=(10.0, 3.0), layout="constrained")
        FigureCanvasAgg(figure)
        total, regret, entropy = figure.subplots(1, 3)
        for name, each in failed.items():
            sums = list(itertools.accumulate(each))
            total.plot(sums, label=name)
            regret.plot([a - b for a, b in zip(sums, best, strict=True)], label=name)
        total.legend()
        total.set_title("failed tries")
        regret.set_title("regret against the best fixed order")
        window = 20
        means = [statistics.fmean(entropies[max(0, n - window) : n + 1]) for n in range(len(entropies))]
        entropy.plot(means)
        entropy.set_title(f"entropy of a command [nats], mean of {window}")
        for axes in (total, regret, entropy):
            axes.set_xlabel("command")
        figure.savefig(drawing, format="svg", metadata={"Date": None})
    return write_whole(path, drawing.getvalue())


def main() -> int:
    """Runs the study."""
    part = Part(
        "strategies",
        "Learned strategies against fixed orders, in a model of a world that changes; the chooser is the product's.",
        {"study": f"{COMMANDS} commands, {len(SEEDS)} seeds"},
    )
    part.parser.add_argument("--plot", type=Path, metavar="FILE.svg", help="draw the first seed")

    def work(options: argparse.Namespace, _: Path) -> Work:
        return {"study": lambda: _measure(options.plot)}

    return part.run(work)


if __name__ == "__main__":
    sys.exit(main())
