"""A process without ROS: runs nets with their functions in a test, which may hold actions and end them by hand."""

from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence

from im_core.clock import monotonic
from im_core.errors import ImError, StateError
from im_pnt.execution.actions import ActionOwner
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, ActionFunction, AskFunction, Functions, GuardFunction
from im_pnt.execution.jobs import Activity, Command, CommandResult, Job
from im_pnt.execution.journal_entries import Record
from im_pnt.execution.notification import Firing, Observer, Phase, StrategyChosen
from im_pnt.execution.operator import Mode
from im_pnt.execution.runner import FunctionRunner, Perform, Spawn
from im_pnt.execution.strategies import StrategyBook
from im_pnt.execution.values import Objects
from im_pnt.model.action import Action, FunctionAction
from im_pnt.model.net import Net
from im_pnt_node.distributed.exchange import Exchange, Transport

_MARKS = {Phase.START: "+", Phase.END: "", Phase.FAILED: "!", Phase.CANCEL: "~", Phase.DOUBT: "?"}


def hold(ctx: ActionContext) -> None:
    """Stands for an action that the test ends by hand; never called."""
    raise StateError(f"transition {ctx.transition} is held by a test and cannot run")


class Clock:
    """Time that a test moves.

    Attributes:
        time: Present time [s].
    """

    def __init__(self) -> None:
        self.time = 0.0

    def __call__(self) -> float:
        """Returns the present time [s]."""
        return self.time


class Recorder(Observer):
    """Keeps what nets tell."""

    def __init__(self) -> None:
        self.firings: list[Firing] = []
        self.troubles: list[str] = []
        self.progress: list[tuple[str, float]] = []
        self.choices: list[tuple[tuple[str, ...], dict[str, float], float, str]] = []
        self.operation: list[tuple[Mode, bool, tuple[str, ...]]] = []
        self.breakpoints: list[tuple[str, ...]] = []

    def fired(self, firings: Sequence[Firing]) -> None:
        """Keeps firings."""
        self.firings.extend(firings)

    def progressed(self, net: str, job: Job | None, text: str, fraction: float) -> None:
        """Keeps a report of progress."""
        self.progress.append((text, fraction))

    def troubled(self, net: str, text: str) -> None:
        """Keeps a complaint."""
        self.troubles.append(text)

    def chose(self, choice: StrategyChosen) -> None:
        """Keeps a choice among strategies."""
        self.choices.append((choice.places, dict(choice.probabilities), choice.entropy, choice.taken))

    def operated(
        self, net: str, mode: Mode, paused: bool, proposed: tuple[str, ...], breakpoints: tuple[str, ...]
    ) -> None:
        """Keeps how a net is operated."""
        self.operation.append((mode, paused, proposed))
        self.breakpoints.append(breakpoints)

    def names(self, net: str) -> list[str]:
        """Returns the firings of a net: ``t+`` START, ``t`` END, ``t!`` FAILED, ``t~`` CANCEL, ``t?`` DOUBT."""
        return [f"{firing.transition}{_MARKS[firing.phase]}" for firing in self.firings if firing.net == net]


class Process:
    """Nets of one process; fires until nothing happens.

    Args:
        nets: The nets.
        actions: Registered functions; :func:`hold` stands for those that the test ends with :meth:`end`.
        guards: Enabling functions.
        name: Name of the process' node.
        transport: To other processes.
        seed: Seed of the choices.
        asks: Functions that find out what became of actions.
        clock: Present time [s].
        spawn: Runs coroutines; otherwise they must not wait for anything.
        observer: Is told what happens, in the place of the recorder.
        strategies: What was learned about strategies.
        record: Takes what happens before it does, for all nets.
        others: What carries out actions of further kinds.
        objects: Data objects that expressions read and store.

    Attributes:
        recorder: Keeps what the nets tell.
        clock: Present time [s].
        held: Actions that wait to be ended.
        results: Results of the commands that have ended.
        answers: What is answered when a held action is asked about, by transition; otherwise that it runs.
    """

    def __init__(
        self,
        nets: Sequence[Net],
        actions: Mapping[str, Callable[..., object]] | None = None,
        guards: Mapping[str, GuardFunction] | None = None,
        *,
        name: str = "node",
        transport: Transport | None = None,
        seed: int = 0,
        asks: Mapping[str, AskFunction] | None = None,
        clock: Callable[[], float] = monotonic,
        spawn: Spawn | None = None,
        observer: Observer | None = None,
        strategies: StrategyBook | None = None,
        record: Record | None = None,
        others: Mapping[type, Perform] | None = None,
        objects: Objects | None = None,
    ) -> None:
        self.recorder = Recorder()
        self.clock = clock
        self.functions = Functions(actions, guards, asks)
        self.exchange = Exchange(name, 1, transport, self.recorder)
        self.held: list[tuple[ActionOwner, Activity, ActionContext]] = []
        self.results: list[CommandResult] = []
        self.answers: dict[str, Answer] = {}
        self._runner = FunctionRunner(self.functions, self.exchange, spawn or drive, others, clock=clock)
        self._name, self._commands = name, 0
        for net in nets:
            self.exchange.add(
                Executor(
                    net,
                    self.functions,
                    self,
                    self.exchange,
                    observer or self.recorder,
                    seed=seed,
                    strategies=strategies,
                    clock=clock,
                    record=record,
                    objects=objects,
                )
            )

    def start(self, owner: ActionOwner, activity: Activity, context: ActionContext) -> None:
        """Starts an action, or holds it."""
        action = activity.action
        if isinstance(action, FunctionAction) and self.functions.actions[action.function] is hold:
            self.held.append((owner, activity, context))
        else:
            self._runner.start(owner, activity, context)

    def direct(self, action: Action) -> ActionFunction | None:
        """Returns the function that does an action when it is called, None for those that are held."""
        function = self._runner.direct(action)
        return None if function is hold else function

    def watch(self, owner: ActionOwner, activity: Activity, work: Awaitable[object]) -> None:
        """Waits for what an action has left to do."""
        self._runner.watch(owner, activity, work)

    def waits(self, activity: Activity) -> bool:
        """Whether a request has been sent, and its reply is still to come."""
        return self._runner.waits(activity)

    def ask(
        self, owner: ActionOwner, activity: Activity, context: ActionContext, answered: Callable[[Answer], None]
    ) -> None:
        """Asks what became of an action."""
        action = activity.action
        asked = isinstance(action, FunctionAction) and action.function in self.functions.asks
        if any(held[1] is activity for held in self.held) and not asked:
            answered(self.answers.get(activity.transition, Answer(Outcome.RUNNING, asked="the test")))
        else:
            self._runner.ask(owner, activity, context, answered)

    def end(self, transition: str, error: ImError | None = None) -> None:
        """Ends the action that has been held longest for a transition.

        Raises:
            StateError: None is held for it.
        """
        entry = next((held for held in self.held if held[1].transition == transition), None)
        if entry is None:
            raise StateError(f"no action of transition {transition} is held")
        self.held.remove(entry)
        entry[0].ended(entry[1], error)
        self.pump()

    def wait(self, seconds: float) -> None:
        """Lets the time of a :class:`Clock` pass, and does all that is due meanwhile, each at its time."""
        assert isinstance(self.clock, Clock)
        end = self.clock.time + seconds
        while True:
            self.pump()
            due = [time for net in self.exchange.nets.values() if (time := net.next_wakeup()) is not None]
            if not due or min(due) > end:
                break
            self.clock.time = max(self.clock.time, min(due))
        self.clock.time = end

    def command(self, net: str, symbol: str, **arguments: object) -> int:
        """Writes a command to a net's tape and fires; its result goes to ``results``. Returns its number."""
        self._commands += 1
        command = Command(self._commands, symbol, dict(arguments), scope=f"{self._name}/{self._commands}")
        self.exchange.nets[net].command(command, self.results.append)
        self.pump()
        return self._commands

    def pump(self, rounds: int = 1000) -> None:
        """Fires until nothing happens.

        Raises:
            StateError: The nets do not come to rest.
        """
        for _ in range(rounds):
            executors = list(self.exchange.nets.values())
            for executor in executors:
                executor.pump()
            if not any(executor.due for executor in executors):
                return
        raise StateError(f"the nets do not come to rest in {rounds} rounds")

    def marking(self, net: str) -> dict[str, int]:
        """Returns the marked places of a net."""
        return self.exchange.nets[net].marking()


def drive(work: Coroutine[object, object, None]) -> None:
    """Runs a coroutine that does not wait for anything."""
    try:
        work.send(None)
    except StopIteration:
        return
    work.close()
    raise StateError("an action waits for something, and without ROS nothing comes")
