"""Execution of a net: two-phase firing driven by events (paper, section 6).

The executor owns the marking. Whatever happens outside reaches it through one queue, from any thread; :meth:`pump`
takes the events in order and fires until nothing is enabled. It never blocks: actions are started by a runner and
confirm later; :meth:`Executor.next_wakeup` tells when time alone has something happen.
"""

from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from im_core.clock import monotonic
from im_core.errors import ImError, nearest
from im_pnt.errors import NetError
from im_pnt.execution.actions import Actions, CheckObjects, Runner
from im_pnt.execution.conflicts import ConflictResolution
from im_pnt.execution.event_loop import EventLoop
from im_pnt.execution.events import (
    ActionEnded,
    Answer,
    Answered,
    CommandWritten,
    Event,
    GuardsChanged,
    TokenArrived,
)
from im_pnt.execution.firing.rule import FiringRule
from im_pnt.execution.functions import Functions
from im_pnt.execution.jobs import Activity, Command, CommandResult, Job
from im_pnt.execution.journal_entries import NetEntry, Record, plain
from im_pnt.execution.notification import Nowhere, Observer, Outlet
from im_pnt.execution.operator import Operator
from im_pnt.execution.strategies import StrategyBook
from im_pnt.execution.timers import Timers
from im_pnt.execution.values import Objects
from im_pnt.model.net import Net


@dataclass(frozen=True, slots=True)
class Rest:
    """Rest of a net; true if nothing keeps the net busy.

    Attributes:
        reasons: What does.
    """

    reasons: tuple[str, ...]

    def __bool__(self) -> bool:
        return not self.reasons

    def __str__(self) -> str:
        return "; ".join(self.reasons) or "at rest"


def rest_of(rule: FiringRule, waiting: int) -> Rest:
    """Return the reasons against the rest of a net.

    Args:
        rule: The net.
        waiting: Events that it has not taken yet.
    """
    reasons = []
    if waiting:
        reasons.append(f"{waiting} events wait to be taken")
    for activity in rule.activities.values():
        how = activity.state.value.replace("_", " ")
        reasons.append(f"{activity.action} of transition {activity.transition} is {how}")
    for job in rule.ledger.jobs():
        if job.request is not None:
            reasons.append(f"request {job.request.id} of net {job.request.caller_net} is open")
        elif job.visit is not None:
            owner = job.visit.owner
            reasons.append(f"tokens of command {owner.command.symbol} of net {owner.key.net} are here")
        else:
            reasons.append(f"command {job.symbol} (number {job.command.id}) is open")
    rest = rule.net.rest_places()
    hidden = {f"{a.transition}.{a.state}" for a in rule.activities.values()}
    for place, tokens in rule.tokens.marking().items():
        if place not in rest and place not in hidden:
            reasons.append(f"place {place} holds {tokens} token{'s' if tokens > 1 else ''} and is no place of rest")
    return Rest(tuple(reasons))


_NOWHERE = Nowhere()


class Executor:
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
        record: Takes what happens before it does, see :mod:`im_pnt.execution.journal_entries`; None: no journal.
        objects: Data objects that expressions read and store; None: there are none here.
        draw: Says which of some contending transitions is taken, by its rank; None: their weights do, with the seed.

    Attributes:
        written: The net as written.
        rule: The marking and the jobs; only for whoever keeps the state of the net.

    Raises:
        NetFileError: A function that the net names is not registered.

    >>> executor.at_rest(), executor.hindrance("empty")
    (Rest(reasons=()), 'place hot holds 0 tokens, and it takes 1')
    >>> executor.command(Command(2, "bakc"))
    Traceback (most recent call last):
    im_pnt.errors.NetError: net oven does not know the command 'bakc' (did you mean 'bake'?)
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
        objects: Objects | None = None,
        draw: Callable[[Sequence[str]], int] | None = None,
    ) -> None:
        functions.check(net)
        self.written = net
        self._wake = wake
        self._inbox: deque[Event] = deque()
        self.rule = FiringRule(net, outlet, observer or Observer(), clock, objects)
        self.rule.record = record
        conflicts = ConflictResolution(self.rule, functions, strategies or StrategyBook(), seed)
        conflicts.drawn = draw
        self._timers = Timers()
        actions = Actions(self, self.rule, conflicts, runner, self._timers, clock, check_objects)
        self._loop = EventLoop(self.rule, conflicts, actions, self._timers, self._inbox, clock)

    @property
    def net(self) -> Net:
        """The expanded net."""
        return self.rule.net

    @property
    def sequence(self) -> int:
        """Number of the last firing."""
        return self.rule.notifier.sequence

    @property
    def activities(self) -> Collection[Activity]:
        """Running actions, in the order of the beginnings."""
        return self.rule.activities.values()

    @property
    def paused(self) -> bool:
        """Whether nothing new is started, for the whole net or for one of the jobs in the net."""
        return self._loop.paused

    @property
    def proposed(self) -> tuple[str, ...]:
        """Transitions waiting for a confirmation."""
        return self._loop.proposed()

    @property
    def breakpoints(self) -> tuple[str, ...]:
        """Transitions that wait for a confirmation in any mode."""
        return self._loop.breakpoints()

    @property
    def operator(self) -> Operator:
        """Operation of the net; only for the keeper of the net's state."""
        return self._loop.operator

    @property
    def record(self) -> Record | None:
        """Receiver of each entry before the effect; None: no journal."""
        return self.rule.record

    # From any thread.

    def command(self, command: Command, on_closed: Callable[[CommandResult], None] | None = None) -> Job:
        """Write a command to the input tape, with the defaults of missing arguments.

        Raises:
            NetError: The net never reads that symbol, or a journal cannot keep its arguments.
            DataError: Its arguments are not what the net declares.
        """
        if command.symbol not in self.rule.readers:
            raise NetError(
                f"net {self.net.name} does not know the command '{command.symbol}'"
                f"{nearest(command.symbol, self.rule.readers)}",
                symbol=command.symbol,
            )
        declared = self.written.commands.get(command.symbol)
        if declared is not None:
            taken = declared.arguments.check(command.arguments, f"command {command.symbol}")
            command = replace(command, arguments=taken)
        if self.record is not None:
            plain(command.arguments, f"the arguments of command {command.symbol}")
        job = Job(command, command.arguments, on_closed=on_closed)
        self.post(CommandWritten(job))
        return job

    def runs(self, activity: Activity) -> bool:
        """Return whether an action has not ended."""
        return self.rule.runs(activity)

    def ended(self, activity: Activity, error: ImError | None, results: dict[str, object] | None = None) -> None:
        """Report the confirmation or failure of an action."""
        self.post(ActionEnded(activity, error, results or {}))

    def answered(self, activity: Activity, answer: Answer) -> None:
        """Report the outcome of an action in doubt."""
        self.post(Answered(activity, answer))

    def built(self, activity: Activity) -> None:
        """Record the notes of a request's builder in the job: the request may outlive the process.

        Raises:
            NetError: A journal cannot keep it.
        """
        self.rule.keep_data(activity)

    def post(self, event: Event) -> None:
        """Put an event into the queue; from any thread, like all the callers."""
        self._inbox.append(event)
        self._wake()

    def guards_changed(self, source: str = "") -> None:
        """Ask guards with a declared source again, or all; once for several calls before the next turn."""
        changed = GuardsChanged(source)
        if changed not in tuple(self._inbox):
            self._inbox.append(changed)
        self._wake()

    def pump(self, limit: int = 1000) -> bool:
        """Take all events and fire until nothing is enabled; a nested call does nothing.

        Args:
            limit: Firings after which to return, so that a net without actions cannot hold the loop.

        Returns:
            Whether there is more to do at once.
        """
        return self._loop.pump(limit)

    def take(self) -> bool:
        """Take the next event, and fire nothing but ends of actions; return whether there was one."""
        return self._loop.take()

    def next_wakeup(self) -> float | None:
        """Return the time of the next call of :meth:`pump` without an event (monotonic) [s]; None: never."""
        return self._timers.next()

    def marking(self) -> dict[str, int]:
        """Return the marked places by name."""
        return self.rule.tokens.marking()

    @property
    def due(self) -> bool:
        """Whether an event or a decision waits for :meth:`pump`."""
        return self._loop.due

    @property
    def stretch(self) -> int:
        """Firings since the last rest or event; 0 unless :meth:`pump` has reached the limit."""
        return self._loop.stretch

    def busy(self) -> bool:
        """Whether an action runs or a job is open."""
        return bool(self.activities or len(self.rule.ledger))

    def at_rest(self) -> Rest:
        """Return whether the net may be replaced now, and if not, why: an action, a job, a token on the way."""
        return rest_of(self.rule, len(self._inbox))

    def jobs(self) -> list[Job]:
        """Return the open jobs, in the order of the arrival."""
        return self.rule.ledger.jobs()

    def coming(self) -> list[Job]:
        """Return the written commands not yet taken by the net and so absent from the jobs."""
        return [event.job for event in list(self._inbox) if isinstance(event, CommandWritten)]

    def concerned(self, node: str, nets: Collection[str]) -> bool:
        """Return whether tokens of the net came from a node, or went to one of the nets."""
        came = (event.context for event in list(self._inbox) if isinstance(event, TokenArrived))
        return any(context is not None and context.node == node for context in came) or any(
            not job.away.keys().isdisjoint(nets) or (job.visit is not None and job.visit.node == node)
            for job in self.jobs()
        )

    def activity(self, number: int) -> Activity:
        """Return a running action, by the number.

        Raises:
            NetError: None of that number runs.
        """
        found = self.rule.activities.get(number)
        if found is None:
            raise NetError(f"net {self.net.name} has no action of number {number} running", number=number)
        return found

    def hindrance(self, transition: str) -> str:
        """Return the present obstacle of a transition of the expanded net; empty: none is known."""
        rule = self.rule
        index = rule.number.get(transition)
        if index is None:
            return f"the net has no transition {transition}"
        tokens, found = rule.tokens.marking(), rule.transitions[index]
        for place, count in found.inputs.items():
            if tokens.get(place, 0) < count:
                return f"place {place} holds {tokens.get(place, 0)} tokens, and it takes {count}"
        if found.symbol is not None and not rule.ledger.tape.has(found.symbol):
            return f"symbol {found.symbol} is not on the tape"
        if found.guard is not None and not self._loop.conflicts.holds(index):
            return f"its guard {found.guard} is false"
        return ""

    def strikes_at(self, transition: str) -> float | None:
        """Return the time at which the delay of a transition will be over (monotonic) [s]; None: it does not run."""
        index = self.rule.number.get(transition)
        return None if index is None else self._loop.delays.strikes_at(index)

    def replay(self, entry: NetEntry) -> None:
        """Apply an entry again: nothing is begun, sent or told.

        Raises:
            NetError: It does not fit the net, or what has happened to it.
        """
        rule = self.rule
        effects = rule.record, rule.outlet, rule.notifier.observer
        rule.record, rule.outlet, rule.notifier.observer = None, _NOWHERE, Observer()
        rule.replaying = True
        try:
            self._loop.apply(entry)
        except (LookupError, TypeError, ValueError, AssertionError) as error:
            text = f"net {self.net.name} cannot do again what a journal tells, {str(entry)[:200]}: {error}"
            raise NetError(text, net=self.net.name) from error
        finally:
            rule.record, rule.outlet, rule.notifier.observer = effects
            rule.replaying = False

    def resume(self) -> None:
        """Go on after a restored state and replayed entries: running actions must be asked about."""
        self._loop.resume()
