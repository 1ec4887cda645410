"""Execution of a net: two-phase firing driven by events (paper, section 6).

The executive owns the marking. Whatever happens outside reaches it through one queue, from any thread; :meth:`pump`
takes the events in order and fires until nothing is enabled. It never blocks: actions are started by a runner and
confirm later; :meth:`Executive.next_wakeup` tells when time alone has something happen.
"""

from collections import deque
from collections.abc import Awaitable, Callable
from typing import Protocol

from im_core.clock import monotonic
from im_core.errors import ImError
from im_pnt.acting import Actions, CheckObjects
from im_pnt.action import Action
from im_pnt.choosing import Chooser
from im_pnt.doubt import Answer
from im_pnt.errors import NetError, nearest
from im_pnt.events import ActionEnded, Answered, CommandWritten, Event, Observer
from im_pnt.firing import FiringRule
from im_pnt.functions import ActionContext, ActionFunction, Functions
from im_pnt.jobs import Activities, Activity, Command, CommandResult, Job
from im_pnt.modes import Mode
from im_pnt.net import Net
from im_pnt.operation import Operation
from im_pnt.record import Entry, Record, encode_command
from im_pnt.replaying import replay
from im_pnt.rest import Rest, rest_of
from im_pnt.snapshot import restore, snapshot
from im_pnt.strategies import StrategyBook
from im_pnt.telling import Outlet
from im_pnt.timers import Timers


class Runner(Protocol):
    """Has actions done; calls :meth:`Executive.ended` when they have confirmed or failed."""

    def start(self, executive: "Executive", activity: Activity, context: ActionContext) -> None:
        """Starts an action; must not block and not raise."""

    def direct(self, action: Action) -> ActionFunction | None:
        """Returns the function that does an action when it is called, None where the action must be started."""

    def watch(self, executive: "Executive", activity: Activity, work: Awaitable[object]) -> None:
        """Waits for what a function that was called directly has left to do."""

    def waits(self, activity: Activity) -> bool:
        """Whether a request has been sent, and its reply is still to come."""

    def ask(
        self, executive: "Executive", activity: Activity, context: ActionContext, answered: Callable[[Answer], None]
    ) -> None:
        """Asks what became of an action that is in doubt; the answer may come from any thread."""


class Executive:
    """A net in execution.

    Args:
        net: The net, as written; verify it first.
        functions: Registered actions and guards.
        runner: Starts actions.
        outlet: Takes tokens and replies for other nets.
        observer: Is told of firings.
        seed: Seed of the choices among contending transitions.
        wake: Called when an event was posted; whoever owns the loop calls :meth:`pump` then.
        check_objects: Looks whether data objects are valid and calls back with the error, if any; None: not checked.
        strategies: What was learned about strategies; None: begins anew.
        clock: Present time, monotonic [s].
        record: Takes what happens before it does, see :mod:`im_pnt.record`; None: no journal.

    Attributes:
        written: The net as written.

    Raises:
        NetFileError: A function that the net names is not registered.
    """

    def __init__(
        self,
        net: Net,
        functions: Functions,
        runner: Runner,
        outlet: Outlet,
        observer: Observer | None = None,
        *,
        seed: int = 0,
        wake: Callable[[], None] = lambda: None,
        check_objects: CheckObjects | None = None,
        strategies: StrategyBook | None = None,
        clock: Callable[[], float] = monotonic,
        record: Record | None = None,
    ) -> None:
        functions.check(net)
        self.written = net
        self._wake = wake
        self._inbox: deque[Event] = deque()
        self._rule = FiringRule(net, outlet, observer or Observer(), clock)
        self._rule.record = record
        chooser = Chooser(self._rule, functions, strategies or StrategyBook(), seed)
        self._timers = Timers()
        actions = Actions(self, self._rule, chooser, runner, self._timers, clock, check_objects)
        self._operation = Operation(self._rule, chooser, actions, self._timers, self._inbox, clock)

    @property
    def net(self) -> Net:
        """The expanded net."""
        return self._rule.net

    @property
    def sequence(self) -> int:
        """Number of the last firing."""
        return self._rule.teller.sequence

    @property
    def activities(self) -> Activities:
        """The actions that run, in the order in which they began."""
        return Activities(self._rule.activities)

    @property
    def mode(self) -> Mode:
        """How the net is operated."""
        return self._operation.operator.mode

    @property
    def paused(self) -> bool:
        """Whether nothing new is started."""
        return self._operation.operator.paused

    @property
    def proposed(self) -> tuple[str, ...]:
        """Transitions that wait to be confirmed."""
        return self._operation.proposed()

    @property
    def record(self) -> Record | None:
        """Takes what happens before it does; None: no journal."""
        return self._rule.record

    # From any thread.

    def command(self, command: Command, on_closed: Callable[[CommandResult], None] | None = None) -> Job:
        """Writes a command to the input tape.

        Raises:
            NetError: The net never reads that symbol, or a journal cannot keep its arguments.
        """
        if command.symbol not in self._rule.readers:
            raise NetError(
                f"net {self.net.name} does not know the command '{command.symbol}'"
                f"{nearest(command.symbol, self._rule.readers)}",
                symbol=command.symbol,
            )
        if self.record is not None:
            encode_command(command)
        job = Job(command, command.arguments, on_closed=on_closed)
        self.post(CommandWritten(job))
        return job

    def ended(self, activity: Activity, error: ImError | None, results: dict[str, object] | None = None) -> None:
        """Says that an action has confirmed, or failed with an error."""
        self.post(ActionEnded(activity, error, results or {}))

    def answered(self, activity: Activity, answer: Answer) -> None:
        """Says what became of an action that is in doubt."""
        self.post(Answered(activity, answer))

    def post(self, event: Event) -> None:
        """Puts an event into the queue; like all that does so, from any thread."""
        self._inbox.append(event)
        self._wake()

    def pump(self, limit: int = 1000) -> bool:
        """Takes all events and fires until nothing is enabled; a call from inside does nothing.

        Args:
            limit: Firings after which to return, so that a net without actions cannot hold the loop.

        Returns:
            Whether there is more to do at once.
        """
        return self._operation.pump(limit)

    def expire(self) -> None:
        """Does what is due by the clock; :meth:`pump` does it too."""
        self._operation.strike()

    def next_wakeup(self) -> float | None:
        """Returns when :meth:`pump` is to be called though no event was posted (monotonic) [s]; None: never."""
        return self._timers.next()

    def marking(self) -> dict[str, int]:
        """Returns the marked places by name."""
        return self._operation.marking()

    @property
    def due(self) -> bool:
        """Whether an event or a decision waits for :meth:`pump`."""
        return self._operation.due

    def busy(self) -> bool:
        """Whether an action runs or a job is open."""
        return bool(self.activities or len(self._rule.ledger) or self._operation.calling)

    def at_rest(self) -> Rest:
        """Returns whether the net may be replaced now, and if not, why: an action, a job, a token on its way."""
        return rest_of(self._rule, self.marking(), len(self._inbox), self._operation.calling)

    def jobs(self) -> list[Job]:
        """Returns the open jobs, in the order of their arrival."""
        return self._rule.ledger.jobs()

    def activity(self, number: int) -> Activity:
        """Returns an action that runs, by its number.

        Raises:
            NetError: None of that number runs.
        """
        found = self._rule.activities.get(number)
        if found is None:
            raise NetError(f"net {self.net.name} has no action of number {number} running", number=number)
        return found

    def state(self) -> dict[str, object]:
        """Returns what the net is in the middle of, as JSON data; this and what follows is for a journal.

        Raises:
            NetError: JSON cannot carry it.
        """
        return snapshot(self._rule, self._operation.operator)

    def restore(self, state: dict[str, object]) -> None:
        """Takes a state back, before anything has happened.

        Raises:
            NetError: It is no state of this net.
        """
        restore(self._rule, self._operation.operator, state)

    def replay(self, entry: Entry) -> None:
        """Does again what an entry tells.

        Raises:
            NetError: It does not fit the net, or what has happened to it.
        """
        replay(self._rule, self._operation.operator, entry)

    def resume(self) -> None:
        """Goes on after :meth:`restore` and :meth:`replay`: what ran has to be asked about."""
        self._operation.resume()
