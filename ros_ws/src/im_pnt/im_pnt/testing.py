"""A process without ROS: runs nets with their functions in a test, which may hold actions and end them by hand."""

from collections.abc import Callable, Coroutine, Mapping, Sequence

from im_core.errors import ImError, StateError
from im_pnt.events import Firing, Observer, Phase
from im_pnt.exchange import Exchange, Transport
from im_pnt.executive import Executive
from im_pnt.functions import ActionContext, Functions, GuardFunction
from im_pnt.jobs import Activity, Command, CommandResult, Job
from im_pnt.net import FunctionAction, Net
from im_pnt.runner import FunctionRunner

_MARKS = {Phase.START: "+", Phase.END: "", Phase.FAILED: "!"}


def hold(ctx: ActionContext) -> None:
    """Stands for an action that the test ends by hand; never called."""
    raise StateError(f"transition {ctx.transition} is held by a test and cannot run")


class Recorder(Observer):
    """Keeps what nets tell."""

    def __init__(self) -> None:
        self.firings: list[Firing] = []
        self.troubles: list[str] = []
        self.progress: list[tuple[str, float]] = []

    def fired(self, firing: Firing) -> None:
        """Keeps a firing."""
        self.firings.append(firing)

    def progressed(self, net: str, job: Job | None, text: str, fraction: float) -> None:
        """Keeps a report of progress."""
        self.progress.append((text, fraction))

    def troubled(self, net: str, text: str) -> None:
        """Keeps a complaint."""
        self.troubles.append(text)

    def names(self, net: str) -> list[str]:
        """Returns the firings of a net by transition: ``t+`` for START, ``t`` for END, ``t!`` for FAILED."""
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
    ) -> None:
        self.recorder = Recorder()
        self.functions = Functions(actions, guards)
        self.exchange = Exchange(name, 1, transport, self.recorder)
        self.held: list[tuple[Executive, Activity, ActionContext]] = []
        self.results: list[CommandResult] = []
        self._runner = FunctionRunner(self.functions, self.exchange, _drive)
        self._commands = 0
        for net in nets:
            self.exchange.add(Executive(net, self.functions, self, self.exchange, self.recorder, seed=seed))

    def start(self, executive: Executive, activity: Activity, context: ActionContext) -> None:
        """Starts an action, or holds it."""
        action = activity.action
        if isinstance(action, FunctionAction) and self.functions.actions[action.function] is hold:
            self.held.append((executive, activity, context))
        else:
            self._runner.start(executive, activity, context)

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

    def command(self, net: str, symbol: str, **arguments: object) -> int:
        """Writes a command to a net's tape and fires; its result goes to ``results``. Returns its number."""
        self._commands += 1
        command = Command(self._commands, symbol, dict(arguments))
        self.exchange.nets[net].command(command, self.results.append)
        self.pump()
        return self._commands

    def pump(self, rounds: int = 1000) -> None:
        """Fires until nothing happens.

        Raises:
            StateError: The nets do not come to rest.
        """
        for _ in range(rounds):
            executives = list(self.exchange.nets.values())
            for executive in executives:
                executive.pump()
            if not any(executive.due for executive in executives):
                return
        raise StateError(f"the nets do not come to rest in {rounds} rounds")

    def marking(self, net: str) -> dict[str, int]:
        """Returns the marked places of a net."""
        return self.exchange.nets[net].marking()


def _drive(work: Coroutine[object, object, None]) -> None:
    """Runs a coroutine that does not wait for anything."""
    try:
        work.send(None)
    except StopIteration:
        return
    work.close()
    raise StateError("an action waits for something, and without ROS nothing comes")
