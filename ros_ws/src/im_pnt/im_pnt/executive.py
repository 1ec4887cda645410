"""Execution of a net: two-phase firing driven by events (paper, section 6).

The executive owns the marking. Whatever happens outside reaches it through one queue, from any thread; :meth:`pump`
takes the events in order and fires until nothing is enabled. It never blocks: actions are started by a runner and
confirm later.
"""

import queue
from collections.abc import Callable, Collection
from typing import Protocol

from im_core.clock import monotonic
from im_core.errors import ImError, WaitTimeoutError
from im_pnt.errors import NetError, nearest
from im_pnt.events import (
    ActionEnded,
    CommandCancelled,
    CommandWritten,
    Event,
    GuardsChanged,
    ObjectInvalidated,
    Observer,
    RequestArrived,
    RequestCancelled,
    TokenArrived,
)
from im_pnt.expand import input_place
from im_pnt.firing import FiringRule, Outlet
from im_pnt.functions import ActionContext, Functions
from im_pnt.jobs import NO_LINEAGE, Activity, Command, CommandResult, Job, Lineage
from im_pnt.net import Net


class Runner(Protocol):
    """Starts actions; calls :meth:`Executive.ended` when they have confirmed or failed."""

    def start(self, executive: "Executive", activity: Activity, context: ActionContext) -> None:
        """Starts an action; must not block and not raise."""


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
        check_objects: Callable[[tuple[str, ...], Callable[[ImError | None], None]], None] | None = None,
    ) -> None:
        functions.check(net)
        self.written = net
        self._runner, self._observer = runner, observer or Observer()
        self._wake, self._check_objects = wake, check_objects
        self._rule = FiringRule(net, functions, self._begin, outlet, self._observer, seed)
        self._inbox: queue.SimpleQueue[Event] = queue.SimpleQueue()

    @property
    def net(self) -> Net:
        """The expanded net."""
        return self._rule.net

    @property
    def sequence(self) -> int:
        """Number of the last firing."""
        return self._rule.sequence

    @property
    def activities(self) -> Collection[Activity]:
        """The actions that run, in the order in which they began."""
        return self._rule.activities.keys()

    # What any thread may call.

    def command(self, command: Command, on_closed: Callable[[CommandResult], None] | None = None) -> Job:
        """Writes a command to the input tape.

        Raises:
            NetError: The net never reads that symbol.
        """
        if command.symbol not in self._rule.readers:
            raise NetError(
                f"net {self.net.name} does not know the command '{command.symbol}'"
                f"{nearest(command.symbol, self._rule.readers)}",
                symbol=command.symbol,
            )
        job = Job(command, command.arguments, on_closed=on_closed)
        self.post(CommandWritten(job))
        return job

    def ended(self, activity: Activity, error: ImError | None, results: dict[str, object] | None = None) -> None:
        """Says that an action has confirmed, or failed with an error."""
        self.post(ActionEnded(activity, error, results or {}))

    def post(self, event: Event) -> None:
        """Puts an event into the queue."""
        self._inbox.put(event)
        self._wake()

    # What only the owner of the loop may call.

    def pump(self, limit: int = 1000) -> bool:
        """Takes all events and fires until nothing is enabled.

        Args:
            limit: Firings after which to return, so that a net without actions cannot hold the loop.

        Returns:
            Whether there is more to do at once.
        """
        fired = 0
        while fired < limit:
            try:
                event = self._inbox.get_nowait()
            except queue.Empty:
                step = self._rule.step()
                if step is None:
                    self._close_forgotten()
                    return False
                fired += step
            else:
                self._handle(event)
                self._rule.reconsider()
        return True

    def expire(self) -> None:
        """Fails the actions whose time is over."""
        now = monotonic()
        for activity in list(self.activities):
            if activity.deadline is not None and now >= activity.deadline:
                activity.deadline = None
                self._cancel_activity(activity)
                what = f"{activity.action} of transition {activity.transition}"
                self.ended(activity, WaitTimeoutError(what=what, seconds=round(now - activity.began, 3)))

    def marking(self) -> dict[str, int]:
        """Returns the marked places by name."""
        return self._rule.tokens.marking()

    @property
    def due(self) -> bool:
        """Whether an event or a decision waits for :meth:`pump`."""
        return self._rule.pending or not self._inbox.empty()

    def busy(self) -> bool:
        """Whether an action runs or a job is open."""
        return bool(self.activities or len(self._rule.ledger))

    # Events.

    def _handle(self, event: Event) -> None:
        match event:
            case CommandWritten(job):
                self._rule.write(job)
            case CommandCancelled(command_id, error):
                self._cancel_command(command_id, error)
            case RequestArrived(request):
                job = Job(request.command, request.arguments, request)
                self._rule.ledger.add(job)
                self._rule.put(input_place(request.service), 1, Lineage(job, None))
            case RequestCancelled(request_id, error):
                for job in self._rule.ledger.of_request(request_id):
                    self._cancel_job(job, error)
            case TokenArrived(place, count):
                self._rule.put(place, count, NO_LINEAGE)
            case ActionEnded(activity, error, results):
                self._end(activity, error, results)
            case ObjectInvalidated(name):
                self._rule.withdraw(name)
            case GuardsChanged():
                pass

    def _begin(self, activity: Activity, context: ActionContext) -> None:
        self._runner.start(self, activity, context)

    def _end(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> None:
        if activity not in self._rule.activities:
            outcome = f"failed ({error})" if error else "confirmed"
            text = f"{activity.action} of transition {activity.transition} {outcome} after it had been given up"
            self._observer.troubled(self.net.name, text)
        elif error is None and activity.objects and self._check_objects is not None and not activity.checked:
            activity.checked = True
            self._check_objects(activity.objects, lambda invalid: self.ended(activity, invalid, results))
        else:
            self._rule.end(activity, error, results)

    def _cancel_command(self, command_id: int | None, error: ImError) -> None:
        for job in self._rule.ledger.of_command(command_id):
            if job.request is None and job in self._rule.ledger.tape.withdraw(job.command.id):
                self._rule.ledger.close(job, error)
            else:
                self._cancel_job(job, error)

    def _cancel_job(self, job: Job, error: ImError) -> None:
        job.cancelled = True
        job.last_failure = error
        for activity in self.activities:
            if activity.lineage.job is job:
                self._cancel_activity(activity)

    def _cancel_activity(self, activity: Activity) -> None:
        for error in activity.cancel():
            self._observer.troubled(self.net.name, f"cancelling {activity.action} broke: {error!r}")

    def _close_forgotten(self) -> None:
        """Ends the commands that a net at rest can acknowledge no more, so that no client waits in vain."""
        if not len(self._rule.ledger) or self.activities:
            return
        rest = self.net.rest_places()
        if any(place not in rest for place in self.marking()):
            return
        for job in self._rule.ledger.begun_commands():
            symbol = job.command.symbol
            text = f"net {self.net.name} came to rest and emitted neither {symbol}_done nor {symbol}_failed"
            self._rule.ledger.close(job, job.last_failure or ImError(text, code="net", symbol=symbol))
