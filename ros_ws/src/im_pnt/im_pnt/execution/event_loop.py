"""The loop of a net: takes events, decides, fires, and lets time strike."""

from collections import deque
from collections.abc import Callable
from functools import partial

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.execution.actions import Actions
from im_pnt.execution.conflicts import ConflictResolution, Delays
from im_pnt.execution.events import (
    ActionEnded,
    Answer,
    Answered,
    BreakpointSet,
    CommandCancelled,
    CommandHeld,
    CommandWritten,
    Confirmed,
    Event,
    GuardsChanged,
    JobUpdate,
    JobUpdateArrived,
    ModeSet,
    NodeForgotten,
    ObjectInvalidated,
    Outcome,
    PauseSet,
    RequestArrived,
    RequestCancelled,
    RequestHeld,
    StepAsked,
    TokenArrived,
)
from im_pnt.execution.firing.closing import close_forgotten, drop_stale, expire, settle_visits
from im_pnt.execution.firing.entries import apply_entry, happens
from im_pnt.execution.firing.foreign_jobs import cancelled_visit
from im_pnt.execution.firing.rule import FiringRule
from im_pnt.execution.jobs import Activity, ActivityState, Job, Reply
from im_pnt.execution.journal_entries import ActivityEnded, NetEntry, changed_data, plain_dict
from im_pnt.execution.operator import Mode, Operator
from im_pnt.execution.timers import Timers
from im_pnt.model.net import Role

_NOTHING: frozenset[int] = frozenset()
_BY_ITSELF = (Mode.AUTOMATIC, False, (), ())


class EventLoop:
    """Event loop of one net.

    Args:
        rule: The marking, and what firing does to it.
        conflicts: Decides about contending transitions.
        actions: Has actions done.
        timers: What is to happen at a time.
        inbox: Events that wait.
        clock: Present time [s].

    Attributes:
        rule: As given.
        conflicts: As given.
        actions: As given.
        operator: How the net is operated.
        stretch: Firings since the net came to rest last, or took an event; 0 unless a pump has reached its limit.
    """

    def __init__(
        self,
        rule: FiringRule,
        conflicts: ConflictResolution,
        actions: Actions,
        timers: Timers,
        inbox: deque[Event],
        clock: Callable[[], float],
    ) -> None:
        self.rule, self.conflicts, self.actions = rule, conflicts, actions
        roles = [transition.role for transition in rule.transitions]
        written = (index for index, role in enumerate(roles) if role in (Role.PLAIN, Role.START))
        self.operator = Operator(written, (index for index, role in enumerate(roles) if role is Role.ACCEPT))
        self._timers, self._inbox, self._clock = timers, inbox, clock
        self.delays = Delays(rule.transitions, rule.enabling, conflicts, timers, clock)
        self.stretch = 0
        self._pumping = False
        self._guard_clocks: set[str] = set()
        self._watched: set[int] = set()
        self._told: tuple[Mode, bool, tuple[str, ...], tuple[str, ...]] = _BY_ITSELF

    @property
    def due(self) -> bool:
        """Whether an event or a decision waits; false during the handling."""
        return not self._pumping and bool(self._inbox or self.rule.enabling.agenda)

    @property
    def paused(self) -> bool:
        """Whether new work is held, for all jobs or for one of the present jobs."""
        return self.operator.paused or any(map(self.rule.is_held, self.rule.ledger.jobs() if self.rule.held else ()))

    def proposed(self) -> tuple[str, ...]:
        """Return the transitions in wait of a confirmation."""
        return tuple(self.rule.transitions[index].origin for index in self.operator.proposed)

    def breakpoints(self) -> tuple[str, ...]:
        """Return the transitions, as written, that wait to be confirmed in any mode."""
        return tuple(sorted(self.rule.transitions[index].origin for index in self.operator.breakpoints))

    def pump(self, limit: int) -> bool:
        """Take all events and fire until nothing is enabled, or for ``limit`` firings.

        Returns:
            Whether there is more to do at once.
        """
        if self._pumping:
            return False
        self._pumping = True
        self.rule.notifier.begin()
        try:
            while self._inbox:  # an answer that has come counts before the time that was left for it
                self._take_event()
            if self._timers.next() is not None:
                self._strike()
            return self._pump(limit)
        finally:
            self._pumping = False
            self.rule.notifier.flush()

    def take(self) -> bool:
        """Take the next event, without a decision; return whether there was one."""
        if self._pumping or not self._inbox:
            return False
        self._pumping = True
        self.rule.notifier.begin()
        try:
            self._take_event()
        finally:
            self._pumping = False
            self.rule.notifier.flush()
        return True

    def fire(self, index: int, owner: Job | None) -> None:
        """Fire a transition for a job, or for none, and begin the action."""
        activity = self.rule.fire(index, owner)
        enabling = self.rule.enabling
        if enabling.crossed or enabling.clocks:
            self.delays.settle(index)
        if not self.operator.free and index in self.operator.written:
            self.operator.spent()
            self.release()
        try:
            if index in self.rule.cancelling and activity is not None:
                self.actions.call_off(activity)
            elif activity is not None:
                self.actions.begin(index, activity)
        finally:
            if not enabling.unmet[index]:
                enabling.consider(index)

    def confirm(self, name: str) -> None:
        """Fire a proposed transition, if still possible."""
        index = self.written_number(name)
        if index not in self.operator.proposed:
            self.rule.notifier.troubled(f"transition {name} was confirmed, but it is not proposed")
            return
        del self.operator.proposed[index]
        if self._may_fire(index):
            self.fire(index, self.conflicts.owner(index))
        else:
            self.rule.notifier.troubled(f"transition {name} was confirmed, but it cannot fire any more")

    def written_number(self, name: str) -> int:
        """Return the number of a transition as written; of none -1."""
        return self.rule.number.get(f"{name}.start", self.rule.number.get(name, -1))

    def resume(self) -> None:
        """Go on after the replay of a journal."""
        self.conflicts.reseed(self.rule.notifier.sequence)
        self.actions.resume()
        self._watch_symbols()
        self.rule.notifier.flush()

    def _pump(self, limit: int) -> bool:
        fired, inbox, enabling = 0, self._inbox, self.rule.enabling
        while fired < limit:
            if inbox:
                self._take_event()
                continue
            index = enabling.next_candidate() if enabling.agenda else None
            if index is None:
                self._come_to_rest()
                self.stretch = 0
                return bool(inbox)
            fired += self._decide(index)
        self.stretch += fired
        return True

    def _take_event(self) -> None:
        self.stretch = 0
        rule = self.rule
        paused = [each for each in rule.activities.values() if rule.is_paused(each)] if rule.held else ()
        self._dispatch(self._inbox.popleft())
        for activity in paused:
            if rule.runs(activity) and not rule.is_paused(activity):
                self.actions.release(activity)
        enabling = self.rule.enabling
        if enabling.stalled or enabling.crossed or not self.operator.free:
            self._after_event()

    def _strike(self) -> None:
        if self._timers.strike(self._clock()):
            self._after_event()

    def _after_event(self) -> None:
        self.conflicts.wake_undeclared()
        self.delays.settle()
        if not self.operator.free:
            self.release()

    def release(self) -> None:
        """Decide again on held and proposed transitions."""
        for index in self.operator.release():
            self.rule.enabling.consider(index)

    # Event handlers.

    def apply(self, entry: NetEntry) -> None:
        """Apply an entry of a journal, now and during a replay.

        Raises:
            ValueError: It does not fit the net, or what has happened to it.
            LookupError: Likewise.
        """
        match entry:
            case ModeSet(mode):
                self.operator.set_mode(mode)
            case PauseSet(paused):
                self.operator.pause(paused)
            case BreakpointSet(name, on):
                if (index := self.written_number(name)) not in self.operator.written:
                    raise ValueError(f"the net has no transition {name}")
                self.operator.set_breakpoint(index, on)
            case _:
                apply_entry(self.rule, entry)

    def _dispatch(self, event: Event) -> None:
        """Take an event; the event is recorded before the effect."""
        rule = self.rule
        match event:
            case TokenArrived() | CommandWritten() | RequestArrived():
                rule.values.stale()
                self._end_visit(event)
                if rule.expires:
                    self._watch_symbols()
            case JobUpdateArrived():
                if not self._end_visit(event) and event.update is not JobUpdate.SETTLED:
                    self.conflicts.wake("")
            case NodeForgotten(node, _, error):
                ending = [job for job in rule.ledger.visits.values() if job.visit and job.visit.node == node]
                self._cancel(event, ending, error)
            case CommandCancelled(command_id, error):
                self._cancel(event, rule.ledger.of_command(command_id), error, everything=command_id is None)
            case CommandHeld() | RequestHeld():
                happens(rule, event)
                self.conflicts.wake("")
            case RequestCancelled(request_id, error):
                self._cancel(event, rule.ledger.of_request(request_id), error)
            case ActionEnded(activity, failure, results):
                self._ended(activity, failure, results)
            # an answer with results ends the action like its own end
            case Answered(activity, Answer(Outcome.DONE, results=results)) if results and self._is_doubtful(activity):
                self._ended(activity, None, results)
            case Answered(activity, answer):
                self.actions.inquiry.take_answer(activity, answer)
            case ObjectInvalidated(name):
                rule.withdraw(name)
                self.conflicts.wake(f"data:{name}")
            case GuardsChanged(source):
                self.conflicts.wake(source)
            case ModeSet() | PauseSet() | BreakpointSet():
                if rule.record is not None:
                    rule.record(event)
                self.apply(event)
                self.release()
            case StepAsked():
                self.operator.step()
                self.release()
            case Confirmed(transition):
                self.confirm(transition)

    def _is_doubtful(self, activity: Activity) -> bool:
        return self.rule.runs(activity) and activity.state is ActivityState.IN_DOUBT

    def _end_visit(self, event: TokenArrived | CommandWritten | RequestArrived | JobUpdateArrived) -> bool:
        """Take an event; return whether it ends a foreign job early, with the actions."""
        found = cancelled_visit(self.rule, event)  # asked first: the event marks the job as cancelled
        if found is None:
            happens(self.rule, event)
            return False
        job, error = found
        self._cancel(event, [job], error)
        return True

    def _cancel(self, event: NetEntry, jobs: list[Job], error: ImError, *, everything: bool = False) -> None:
        """Take an event that ends jobs early; the jobs are asked first, for the event may close them."""
        rule, wanted = self.rule, {job.number for job in jobs}
        running = [
            activity
            for activity in rule.activities.values()
            if everything or (activity.lineage.job is not None and activity.lineage.job.number in wanted)
        ]
        happens(rule, event)
        for activity in running:
            if rule.runs(activity):
                self.actions.cancel(activity, error)
            else:
                self.actions.abandon(activity, error)
        for job in jobs:
            self.conflicts.wake_job(job)
        if rule.held:  # what is to end is held no more
            self.conflicts.wake("")

    def _ended(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> None:
        rule, data = self.rule, None
        runs = rule.runs(activity)
        if rule.record is not None:
            try:
                results = plain_dict(results, f"the results of {activity.action}")
                if runs and activity.lineage.job is not None:
                    data = changed_data(activity.lineage.job)
            except NetError as unfit:
                error, results = error or unfit, {}
            rule.record(ActivityEnded(activity.number, error, results, data))
        if not runs:
            outcome = f"failed ({error})" if error else "confirmed"
            text = f"{activity.action} of transition {activity.transition} {outcome} after it had been given up"
            rule.notifier.troubled(text)
            return
        activity.reply = Reply(error, results)
        self.actions.finish(activity, error, results)

    # Deciding.

    def _decide(self, index: int) -> bool:
        """Decide on a candidate; return whether a transition fired."""
        if self.operator.free and index in self.conflicts.certain and not self.rule.held:
            self.fire(index, self.rule.first_owner(index))
            return True
        self.conflicts.barred = _NOTHING if self.operator.free else self.operator.barred
        if index in self.conflicts.delayed and self.delays.waits(index):
            return False
        if index in self.conflicts.barred:
            self._hold(index)
            return False
        winner = self.conflicts.choose(index)
        if winner is None:
            self.delays.give_up(index)
            return False
        if winner != index and index not in self.rule.enabling.stalled:
            self.rule.enabling.consider(index)
        self.fire(winner, self.conflicts.owner(winner))
        return True

    def _hold(self, index: int) -> None:
        """Keep an enabled transition for the operator: for a confirmation, or until firing is allowed again."""
        if self.operator.asks(index) and self._may_fire(index):
            self.operator.proposed[index] = None
        elif index not in self.rule.enabling.stalled:
            self.operator.hold(index)

    def _may_fire(self, index: int) -> bool:
        self.conflicts.barred = frozenset()
        return self.conflicts.may_fire(index)

    # Coming to rest.

    def _come_to_rest(self) -> None:
        if self.conflicts.clocks:
            self._arm_guard_clocks()
        if self.rule.ledger.visits:
            settle_visits(self.rule)
        if self.rule.ledger.count and self.operator.idle:
            drop_stale(self.rule)
            close_forgotten(self.rule)
        if self.operator.free and self._told == _BY_ITSELF and not self.rule.held:
            return
        self.operator.spent()
        told = (self.operator.mode, self.paused, self.proposed(), self.breakpoints())
        if told != self._told:
            self._told = told
            self.rule.notifier.operated(*told)

    def _watch_symbols(self) -> None:
        """Set the expiry of symbols on the tape."""
        for job in self.rule.ledger.tape.waiting():
            seconds = self.rule.expires.get(job.symbol)
            if seconds and job.number not in self._watched:
                self._watched.add(job.number)
                self._timers.at(self._clock() + seconds, partial(self._expire, job))

    def _expire(self, job: Job) -> None:
        self._watched.discard(job.number)
        expire(self.rule, job)

    def _arm_guard_clocks(self) -> None:
        for source, period in self.conflicts.clocks.items():
            if source not in self._guard_clocks and self.conflicts.stalls(source):
                self._guard_clocks.add(source)
                self._timers.at(self._clock() + period, partial(self._tick, source))

    def _tick(self, source: str) -> None:
        self._guard_clocks.discard(source)
        self.conflicts.wake(source)
