"""Execution of a net: two-phase firing driven by events (paper, section 6).

The executive owns the marking. Whatever happens outside reaches it through one queue, from any thread; :meth:`pump`
takes the events in order and fires until nothing is enabled. It never blocks: actions are started by a runner and
confirm later.
"""

import queue
import random
from collections.abc import Callable
from typing import Protocol

from im_core.clock import monotonic
from im_core.errors import ImError, WaitTimeoutError
from im_pnt.compiled import compile_net
from im_pnt.errors import NetError, nearest
from im_pnt.events import (
    ActionEnded,
    CommandCancelled,
    CommandWritten,
    Event,
    Firing,
    GuardsChanged,
    ObjectInvalidated,
    Observer,
    Phase,
    RequestArrived,
    RequestCancelled,
    TokenArrived,
)
from im_pnt.expand import active_place, expand, input_place
from im_pnt.functions import ActionContext, Functions
from im_pnt.jobs import NO_LINEAGE, Activity, Command, CommandResult, Job, Lineage, Request
from im_pnt.ledger import Ledger
from im_pnt.net import Net, RemotePlace, Role, Transition
from im_pnt.tape import ends
from im_pnt.tokens import Tokens

_WAITING_ROLES = (Role.END, Role.FAILED, Role.WITHDRAWN)


class Runner(Protocol):
    """Starts actions; calls :meth:`Executive.ended` when they have confirmed or failed."""

    def start(self, executive: "Executive", activity: Activity, context: ActionContext) -> None:
        """Starts an action; must not block and not raise."""


class Outlet(Protocol):
    """Where tokens for other nets and replies to callers go."""

    def send_token(self, net: str, target: RemotePlace, count: int) -> None:
        """Sends tokens to a place of another net."""

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answers a request."""


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
        self.net = expand(net)
        self.functions = functions
        self.sequence = 0
        self.activities: dict[Activity, None] = {}
        self._runner, self._outlet, self._observer = runner, outlet, observer or Observer()
        self._wake, self._check_objects = wake, check_objects
        self._compiled = compile_net(self.net)
        self._transitions = tuple(self.net.transitions.values())
        self._number = {name: index for index, name in enumerate(self._compiled.transitions)}
        self._place = {name: index for index, name in enumerate(self._compiled.places)}
        free = [i for i, t in enumerate(self._transitions) if t.role not in _WAITING_ROLES]
        initial = self._compiled.marking_vector(self.net.initial_marking())
        self._ledger = Ledger()
        self._tokens = Tokens(self._compiled, free, initial, self._ledger.merge)
        self._enabling = self._tokens.enabling
        self._readers: dict[str, list[int]] = {}
        for index in free:
            symbol = self._transitions[index].symbol
            if symbol:
                self._readers.setdefault(symbol, []).append(self._enabling.conflict_set[index])
        self._inbox: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._stalled: set[int] = set()
        self._dice = random.Random(f"{seed}:{net.name}")

    # What any thread may call.

    def command(self, command: Command, on_closed: Callable[[CommandResult], None] | None = None) -> Job:
        """Writes a command to the input tape.

        Raises:
            NetError: The net never reads that symbol.
        """
        if command.symbol not in self._readers:
            raise NetError(
                f"net {self.net.name} does not know the command '{command.symbol}'"
                f"{nearest(command.symbol, self._readers)}",
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
                conflict_set = self._enabling.next_decision()
                if conflict_set is None:
                    self._close_forgotten()
                    return False
                fired += self._decide(conflict_set)
            else:
                self._handle(event)
                for conflict_set in self._stalled:
                    self._enabling.consider(conflict_set)
                self._stalled.clear()
        return True

    def expire(self) -> None:
        """Fails the actions whose time is over."""
        now = monotonic()
        for activity in list(self.activities):
            if activity.deadline is not None and now >= activity.deadline:
                activity.deadline = None
                activity.cancel()
                what = f"{activity.action} of transition {activity.transition}"
                self.ended(activity, WaitTimeoutError(what=what, seconds=round(now - activity.began, 3)))

    def marking(self) -> dict[str, int]:
        """Returns the marked places by name."""
        return self._tokens.marking()

    @property
    def due(self) -> bool:
        """Whether an event or a decision waits for :meth:`pump`."""
        return self._enabling.pending or not self._inbox.empty()

    def busy(self) -> bool:
        """Whether an action runs or a job is open."""
        return bool(self.activities or len(self._ledger))

    # Events.

    def _handle(self, event: Event) -> None:
        match event:
            case CommandWritten(job):
                self._ledger.add(job)
                self._ledger.tape.write(job)
                for conflict_set in self._readers[job.command.symbol]:
                    self._enabling.consider(conflict_set)
            case CommandCancelled(command_id, error):
                self._cancel_command(command_id, error)
            case RequestArrived(request):
                job = Job(request.command, request.arguments, request)
                self._ledger.add(job)
                self._tokens.put(self._place[input_place(request.service)], 1, Lineage(job, None))
            case RequestCancelled(request_id, error):
                for job in self._ledger.of_request(request_id):
                    self._cancel_job(job, error)
            case TokenArrived(place, count):
                self._tokens.put(self._place[place], count, NO_LINEAGE)
            case ActionEnded(activity, error, results):
                self._end(activity, error, results)
            case ObjectInvalidated(name):
                self._withdraw(name)
            case GuardsChanged():
                pass

    def _cancel_command(self, command_id: int | None, error: ImError) -> None:
        for job in self._ledger.of_command(command_id):
            if job.request is None and job in self._ledger.tape.withdraw(job.command.id):
                self._ledger.close(job, error)
            else:
                self._cancel_job(job, error)

    def _cancel_job(self, job: Job, error: ImError) -> None:
        job.cancelled = True
        job.last_failure = error
        for activity in self.activities:
            if activity.lineage.job is job:
                activity.cancel()

    def _withdraw(self, name: str) -> None:
        for place in self.net.places.values():
            if place.data_object == name and place.on_invalid:
                index = self._number[f"{place.name}.withdrawn"]
                while self._enabling.tokens[self._place[place.name]]:
                    lineage = self._tokens.take_inputs(index)
                    failure = ImError(f"data object {name} lost its validity", code="data", object=name)
                    if lineage.job is not None:
                        lineage.job.last_failure = failure
                    self._give(index, Lineage(lineage.job, failure))
                    self._tell(self._transitions[index].name, Phase.END, lineage)

    def _close_forgotten(self) -> None:
        """Ends the commands that a net at rest can acknowledge no more, so that no client waits in vain."""
        if not len(self._ledger) or self.activities:
            return
        rest = self.net.rest_places()
        if any(place not in rest for place in self.marking()):
            return
        for job in self._ledger.begun_commands():
            symbol = job.command.symbol
            text = f"net {self.net.name} came to rest and emitted neither {symbol}_done nor {symbol}_failed"
            self._ledger.close(job, job.last_failure or ImError(text, code="net", symbol=symbol))

    # Decisions.

    def _decide(self, conflict_set: int) -> int:
        """Fires one transition of a conflict set, if one may fire; returns how many did."""
        verdicts: dict[tuple[str, int], bool] = {}
        choices: list[int] = []
        stalled = False
        for index in self._enabling.enabled(conflict_set):
            transition = self._transitions[index]
            if transition.symbol and not self._ledger.tape.has(transition.symbol):
                continue
            if transition.guard is not None:
                lineage = self._tokens.peek_inputs(index)
                key = (transition.guard.name, id(lineage.job))
                if key not in verdicts:
                    verdicts[key] = self._ask_guard(transition, lineage)
                if verdicts[key] == transition.guard.negated:
                    stalled = True
                    continue
            choices.append(index)
        if not choices:
            if stalled:
                self._stalled.add(conflict_set)
            return 0
        best = max(self._transitions[index].priority for index in choices)
        choices = [index for index in choices if self._transitions[index].priority == best]
        self._fire(choices[0] if len(choices) == 1 else self._dice.choice(choices))
        self._enabling.consider(conflict_set)
        return 1

    def _ask_guard(self, transition: Transition, lineage: Lineage) -> bool:
        assert transition.guard is not None
        name = transition.guard.name
        context = ActionContext(self.net.name, transition.origin, lineage, progress=self._progress)
        try:
            return bool(self.functions.guards[name](context))
        except Exception as error:  # a guard is foreign code: whatever it raises must not stop the net
            failure = error if isinstance(error, ImError) else ImError(f"guard {name} failed: {error!r}", code="guard")
            if lineage.job is not None:
                lineage.job.last_failure = failure
            self._observer.troubled(self.net.name, f"guard {name} counts as false: {failure}")
            return False

    def _fire(self, index: int) -> None:
        transition = self._transitions[index]
        if transition.role is Role.ACCEPT:
            self._ledger.serving = self._tokens.first(self._place[input_place(transition.origin)]).job
        lineage = self._tokens.take_inputs(index)
        symbol = transition.symbol or ""
        if symbol:
            lineage = Lineage(self._ledger.tape.read(symbol), lineage.failure)
        match transition.role:
            case Role.START:
                self._start(index, lineage, symbol)
                return
            case Role.ACCEPT | Role.FINISH:
                lineage = Lineage(self._ledger.serving, None)
            case Role.FINISH_FAILED:
                job = self._ledger.serving
                lineage = Lineage(job, _failure_of(job, transition, lineage.failure))
            case Role.RETURN:
                self._return(lineage)
        passed_on = lineage.failure if transition.role is Role.FINISH_FAILED else None
        self._give(index, Lineage(lineage.job, passed_on))
        symbol = symbol or (transition.emit[0] if transition.emit else "")
        self._tell(transition.name, Phase.END, lineage, symbol=symbol)
        self._emit(transition, lineage)

    def _return(self, lineage: Lineage) -> None:
        job = lineage.job
        if job is not None and job.request is not None and not job.closed:
            self._ledger.close(job, lineage.failure)
            self._outlet.send_reply(job.request, lineage.failure, job.results)

    def _start(self, index: int, lineage: Lineage, symbol: str) -> None:
        transition = self._transitions[index]
        assert transition.action is not None
        began = monotonic()
        deadline = began + transition.timeout if transition.timeout is not None else None
        end = self._transitions[self._number[f"{transition.origin}.end"]]
        objects = tuple(
            data_object for place in end.outputs if (data_object := self.net.places[place].data_object) is not None
        )
        activity = Activity(
            self.net.name, transition.origin, index, transition.action, lineage, began, deadline, objects
        )
        self.activities[activity] = None
        self._tokens.put(self._place[active_place(transition.origin)], 1, lineage)
        self._tell(transition.origin, Phase.START, lineage, symbol=symbol)
        context = ActionContext(self.net.name, transition.origin, lineage, activity, self._progress)
        self._runner.start(self, activity, context)

    def _end(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> None:
        if activity not in self.activities:
            outcome = f"failed ({error})" if error else "confirmed"
            text = f"{activity.action} of transition {activity.transition} {outcome} after it had been given up"
            self._observer.troubled(self.net.name, text)
            return
        if error is None and activity.objects and self._check_objects is not None and not activity.checked:
            activity.checked = True
            self._check_objects(activity.objects, lambda invalid: self.ended(activity, invalid, results))
            return
        del self.activities[activity]
        job = activity.lineage.job
        if job is not None and error is not None:
            job.last_failure = error
        if job is not None and error is None:
            job.replies[activity.transition] = results
        index = self._number[f"{activity.transition}.{'failed' if error else 'end'}"]
        self._tokens.take_one(self._place[active_place(activity.transition)], activity.lineage)
        self._give(index, Lineage(job, error))
        lineage = Lineage(job, error)
        transition = self._transitions[index]
        symbol = transition.emit[0] if transition.emit else ""
        duration = monotonic() - activity.began
        phase = Phase.FAILED if error else Phase.END
        self._tell(activity.transition, phase, lineage, symbol=symbol, duration=duration)
        self._emit(transition, lineage)

    def _give(self, index: int, lineage: Lineage) -> None:
        self._tokens.give_outputs(index, lineage)
        for target, count in self._transitions[index].remote_outputs.items():
            self._outlet.send_token(self.net.name, target, count)

    # What is told.

    def _emit(self, transition: Transition, lineage: Lineage) -> None:
        for emitted in transition.emit:
            self._observer.emitted(self.net.name, emitted, lineage)
            job = self._ledger.ended_by(emitted, lineage.job)
            if job is not None:
                done = ends(emitted, job.command.symbol)
                self._ledger.close(job, None if done else _failure_of(job, transition, lineage.failure))

    def _progress(self, lineage: Lineage, text: str, fraction: float) -> None:
        if lineage.job is not None and fraction >= 0.0:
            lineage.job.progress = fraction
        self._observer.progressed(self.net.name, lineage.job, text, fraction)

    def _tell(
        self, transition: str, phase: Phase, lineage: Lineage, *, symbol: str = "", duration: float = 0.0
    ) -> None:
        self.sequence += 1
        job = lineage.job
        message = str(lineage.failure) if phase is not Phase.START and lineage.failure is not None else ""
        self._observer.fired(
            Firing(
                self.net.name,
                transition,
                self.sequence,
                phase,
                symbol,
                job.command.id if job else 0,
                message,
                duration,
                job.progress if job else -1.0,
            )
        )


def _failure_of(job: Job | None, transition: Transition, failure: ImError | None = None) -> ImError:
    """Why a job failed: the failure at hand, the last one of the job, or only where it ended."""
    if failure is not None:
        return failure
    if job is not None and job.last_failure is not None:
        return job.last_failure
    return ImError(f"the net ended it at transition {transition.name}", code="net", transition=transition.name)
