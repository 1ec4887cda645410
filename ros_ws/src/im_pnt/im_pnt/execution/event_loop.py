"""The loop of a net: takes events, decides, fires, and lets time strike."""

from collections import deque
from collections.abc import Callable
from functools import partial
from inspect import isawaitable
from typing import NamedTuple

from im_core.errors import FOREIGN, ImError
from im_pnt.errors import NetError
from im_pnt.execution.actions import Actions
from im_pnt.execution.conflicts import ConflictResolution, Delays
from im_pnt.execution.events import (
    ActionEnded,
    Answer,
    Answered,
    CommandCancelled,
    CommandHeld,
    CommandWritten,
    Confirmed,
    Event,
    GuardsChanged,
    ModeSet,
    NodeForgotten,
    ObjectInvalidated,
    Outcome,
    PauseSet,
    RequestArrived,
    RequestCancelled,
    StepAsked,
    Tiding,
    TidingArrived,
    TokenArrived,
)
from im_pnt.execution.firing.happening import apply_entry, happens
from im_pnt.execution.firing.rest import close_forgotten, drop_stale, expire, settle_visits
from im_pnt.execution.firing.rule import FiringRule
from im_pnt.execution.firing.visits import cancelled_visit
from im_pnt.execution.functions import ActionFunction, GuardFunction
from im_pnt.execution.jobs import NO_LINEAGE, Activity, ActivityState, Job, Reply
from im_pnt.execution.notification import Firing, Phase
from im_pnt.execution.operator import Mode, Operator
from im_pnt.execution.record import ActivityEnded, EndFired, NetEntry, TransitionFired, changed_data, plain_dict
from im_pnt.execution.timers import Timers
from im_pnt.expression.scope import read_objects
from im_pnt.model.expand import active_place
from im_pnt.model.net import RemotePlace, Role

_NOTHING: frozenset[int] = frozenset()
_BY_ITSELF = (Mode.AUTOMATIC, False, ())


_Places = tuple[tuple[int, tuple[int, ...]], ...]
"""Places, each with the transitions that take from it."""


class _Step(NamedTuple):
    """A transition that needs no more than tokens, a guard and a call.

    Attributes:
        inputs: Its input places.
        outputs: Its output places; for a ``t.start`` those of ``t.end``.
        rivals: The other transitions that share an input place.
        alike: Whether it and they have equal guards and priorities, and only weights tell them apart.
        guard: Its guard, None if it has none.
        negated: Whether that is negated.
        entry: What a journal is told when it fires.
        firing: What the observer is told.
        call: Of a ``t.start``: the place ``t.active``, the name of ``t.end``, what is told of it, and the function.
        places: Numbers of all these places, ``t.active`` aside, and of the input places of the rivals.
        remote: Places of other nets that it marks, likewise; with the numbers of their tokens.
    """

    inputs: _Places
    outputs: _Places
    rivals: tuple[int, ...]
    alike: bool
    guard: GuardFunction | None
    negated: bool
    entry: TransitionFired
    firing: Firing
    call: tuple[int, str, Firing, ActionFunction] | None
    places: frozenset[int]
    remote: tuple[tuple[RemotePlace, int], ...]


class EventLoop:
    """What happens in the loop of one net.

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
        self._delays = Delays(rule.transitions, rule.enabling, conflicts, timers, clock)
        self._steps = [self._step(index) for index in range(len(rule.transitions))]
        self._asked = [conflicts.context(index, NO_LINEAGE) for index in range(len(rule.transitions))]
        self._contexts = [actions.fresh_context(index) for index in range(len(rule.transitions))]
        self.stretch = 0
        self._pumping = False
        self._guard_clocks: set[str] = set()
        self._watched: set[int] = set()
        self._told: tuple[Mode, bool, tuple[str, ...]] = (self.operator.mode, self.operator.paused, ())

    @property
    def due(self) -> bool:
        """Whether an event or a decision waits; not while they are being dealt with."""
        return not self._pumping and bool(self._inbox or self.rule.enabling.agenda)

    def proposed(self) -> tuple[str, ...]:
        """Returns the transitions that wait to be confirmed."""
        return tuple(self.rule.transitions[index].origin for index in self.operator.proposed)

    def pump(self, limit: int) -> bool:
        """Takes all events and fires until nothing is enabled, or for ``limit`` firings.

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
        """Takes the next event, and decides nothing; returns whether there was one."""
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
        """Fires a transition for a job, or for nobody, and begins its action."""
        activity = self.rule.fire(index, owner)
        enabling = self.rule.enabling
        if enabling.crossed or enabling.clocks:
            self._delays.settle(index)
        if not self.operator.free and index in self.operator.written:
            self.operator.spent()
            self.release()
        try:
            if activity is not None:
                self.actions.begin(index, activity)
        finally:
            if not enabling.unmet[index]:
                enabling.consider(index)

    def confirm(self, name: str) -> None:
        """Fires a proposed transition, if it can still fire."""
        index = self.rule.number.get(f"{name}.start", self.rule.number.get(name, -1))
        if index not in self.operator.proposed:
            self.rule.notifier.troubled(f"transition {name} was confirmed, but it is not proposed")
            return
        del self.operator.proposed[index]
        if self._may_fire(index):
            self.fire(index, self.conflicts.owner(index))
        else:
            self.rule.notifier.troubled(f"transition {name} was confirmed, but it cannot fire any more")

    def resume(self) -> None:
        """Goes on after a journal was replayed."""
        self.conflicts.reseed(self.rule.notifier.sequence)
        self.actions.resume()
        self._watch_symbols()
        self.rule.notifier.flush()

    def _pump(self, limit: int) -> bool:
        fired, inbox, enabling = 0, self._inbox, self.rule.enabling
        operator = self.operator
        while fired < limit:
            if inbox:
                self._take_event()
                continue
            if operator.free and enabling.agenda:
                fired += self._sweep(limit - fired)
                if inbox or fired >= limit:
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
        self._dispatch(self._inbox.popleft())
        enabling = self.rule.enabling
        if enabling.stalled or enabling.crossed or not self.operator.free:
            self._after_event()

    def _strike(self) -> None:
        if self._timers.strike(self._clock()):
            self._after_event()

    def _after_event(self) -> None:
        self.conflicts.wake_undeclared()
        self._delays.settle()
        if not self.operator.free:
            self.release()

    def release(self) -> None:
        """Decides again about what was held back or proposed."""
        for index in self.operator.release():
            self.rule.enabling.consider(index)

    # Event handlers.

    def apply(self, entry: NetEntry) -> None:
        """Does what an entry of a journal tells, now and when it is replayed.

        Raises:
            ValueError: It does not fit the net, or what has happened to it.
            LookupError: Likewise.
        """
        match entry:
            case ModeSet(mode):
                self.operator.set_mode(mode)
            case PauseSet(paused):
                self.operator.pause(paused)
            case _:
                apply_entry(self.rule, entry)

    def _dispatch(self, event: Event) -> None:
        """Takes an event; it is recorded before anything is done."""
        rule = self.rule
        match event:
            case TokenArrived() | CommandWritten() | RequestArrived():
                rule.values.stale()
                cancelled = cancelled_visit(rule, event)
                happens(rule, event)
                if rule.expires:
                    self._watch_symbols()
                if cancelled is not None and cancelled.last_failure is not None:
                    self._cancel([cancelled], cancelled.last_failure)
            case TidingArrived():
                cancelled = cancelled_visit(rule, event)
                happens(rule, event)
                if cancelled is not None and cancelled.last_failure is not None:
                    self._cancel([cancelled], cancelled.last_failure)
                elif event.tiding is not Tiding.SETTLED:
                    self.conflicts.wake("")
            case NodeForgotten(node, _, error):
                ending = [job for job in rule.ledger.visits.values() if job.visit and job.visit.node == node]
                happens(rule, event)
                self._cancel(ending, error)
            case CommandCancelled(command_id, error):
                jobs = rule.ledger.of_command(command_id)
                happens(rule, event)
                self._cancel(jobs, error, everything=command_id is None)
            case CommandHeld():
                happens(rule, event)
                self.conflicts.wake("")
            case RequestCancelled(request_id, error):
                jobs = rule.ledger.of_request(request_id)
                happens(rule, event)
                self._cancel(jobs, error)
            case ActionEnded(activity, failure, results):
                self._ended(activity, failure, results)
            case Answered(activity, Answer(Outcome.DONE, results=results)) if results and self._is_doubtful(activity):
                self._ended(activity, None, results)
            case Answered(activity, answer):
                self.actions.inquiry.take_answer(activity, answer)
            case ObjectInvalidated(name):
                rule.withdraw(name)
                self.conflicts.wake(f"data:{name}")
            case GuardsChanged(source):
                self.conflicts.wake(source)
            case ModeSet() | PauseSet():
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
        runs = self.rule.activities.get(activity.number) is activity
        return runs and activity.state is ActivityState.IN_DOUBT

    def _cancel(self, jobs: list[Job], error: ImError, *, everything: bool = False) -> None:
        wanted = {job.number for job in jobs}
        for activity in list(self.rule.activities.values()):
            job = activity.lineage.job
            if everything or (job is not None and job.number in wanted):
                self.actions.cancel(activity, error)
        for job in jobs:
            self.conflicts.wake_job(job)

    def _ended(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> None:
        rule, data = self.rule, None
        runs = rule.activities.get(activity.number) is activity
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

    def _sweep(self, limit: int) -> int:
        """Fires transitions to whose tokens nothing belongs, and that need no more than a guard and a call.

        Ends when an event waits, a transition needs more, nothing is enabled, or the limit is reached.

        Args:
            limit: Most firings.

        Returns:
            The number of firings.
        """
        steps, inbox, rule, conflicts = self._steps, self._inbox, self.rule, self.conflicts
        enabling, queues, record, clock = rule.enabling, rule.tokens.queues, rule.record, self._clock
        tokens, unmet, listed = enabling.tokens, enabling.unmet, enabling.listed
        agenda, stalled, fired_so_far = enabling.agenda, enabling.stalled, rule.notifier.fired.append
        asked, contexts = self._asked, self._contexts
        conflicts.barred = _NOTHING
        fired = 0
        while agenda and fired < limit and not inbox:
            index = agenda.popleft()
            listed[index] = False
            if unmet[index] or index in stalled:
                continue
            step = steps[index]
            if step is None or (queues and not step.places.isdisjoint(queues)):
                agenda.appendleft(index)
                listed[index] = True
                break
            inputs, outputs, rivals, alike, guard, negated, entry, firing, call, _, remote = step
            contending = [index]
            for rival in rivals:
                if not unmet[rival]:
                    contending.append(rival)  # noqa: PERF401 - a comprehension is a call more
            winner = index
            if alike or len(contending) == 1:  # what the guard says of one, it says of all
                if guard is not None:
                    context = asked[index]
                    try:
                        held = bool(guard(context)) == negated
                    except FOREIGN as error:  # a guard is foreign code: whatever it raises must not stop the net
                        held = conflicts.guard_broke(index, NO_LINEAGE, error) == negated
                    if context.used:
                        asked[index] = conflicts.context(index, NO_LINEAGE)
                    if held:
                        stalled.update(contending)
                        continue
                if len(contending) > 1:
                    winner = conflicts.draw(contending)
            else:
                chosen = conflicts.choose(index)
                if chosen is None:
                    continue
                winner = chosen
            if winner != index:
                if index not in stalled:
                    listed[index] = True
                    agenda.append(index)
                index, step = winner, steps[winner]
                if step is None or (queues and not step.places.isdisjoint(queues)):
                    self.fire(index, None)
                    return fired + 1
                inputs, outputs, _, _, _, _, entry, firing, call, _, remote = step
            if record is not None:
                record(entry)
            for place, consumers in inputs:
                left = tokens[place] - 1
                tokens[place] = left
                if not left:
                    for consumer in consumers:
                        unmet[consumer] += 1
                    if stalled:
                        stalled.difference_update(consumers)
                elif stalled:
                    enabling.consider_stalled(consumers)
            fired += 1
            fired_so_far(firing)
            if call is not None:
                active, end, ended, function = call
                tokens[active] += 1
                began = clock()
                rule.call = index, began
                context, failure = contexts[index], None
                try:
                    outcome = function(context)
                except BaseException as raised:
                    outcome, failure = None, raised
                if context.used:
                    contexts[index] = self.actions.fresh_context(index)
                if failure is not None or rule.call is None or (outcome is not None and isawaitable(outcome)):
                    try:
                        self.actions.called(context, outcome, failure)
                    finally:
                        if not unmet[index]:
                            enabling.consider(index)
                    continue
                if record is not None:
                    record(EndFired(rule.notifier.sequence, end, None, None))
                rule.call = None
                tokens[active] -= 1
                fired_so_far((ended, clock() - began))
            for place, consumers in outputs:
                before = tokens[place]
                tokens[place] = before + 1
                if not before:
                    for consumer in consumers:
                        left = unmet[consumer] - 1
                        unmet[consumer] = left
                        if not left and not listed[consumer]:
                            listed[consumer] = True
                            agenda.append(consumer)
                elif stalled:
                    enabling.consider_stalled(consumers)
            for target, count in remote:
                rule.outlet.send_token(rule.net.name, target, count)
            if not unmet[index] and not listed[index]:
                stalled.discard(index)
                listed[index] = True
                agenda.append(index)
        return fired

    def _step(self, index: int) -> _Step | None:
        rule = self.rule
        transition, compiled = rule.transitions[index], rule.enabling.compiled
        last, call = index, None
        if transition.role is Role.START:
            last = rule.number[f"{transition.origin}.end"]
            function = self.actions.functions.get(index)
            if function is None or transition.timeout is not None or transition.strategy is not None:
                return None
            if transition.result or transition.store:
                return None
            ended = rule.notifier.foreseen(transition.origin, Phase.END)
            active = rule.place[active_place(transition.origin)]
            call = active, f"{transition.origin}.end", ended, function
        elif transition.role is not Role.PLAIN:
            return None
        end = rule.transitions[last]
        arcs = (*compiled.inputs[index], *compiled.outputs[last])
        if (
            transition.symbol is not None
            or (transition.guard is not None and read_objects(transition.guard.name))
            or end.emit
            or transition.resets
            or not all(weight == 1 and self._is_plain(place) for place, weight in arcs)
            or any(rule.net.places[place].data_object for place in end.outputs if call is not None)
        ):
            return None

        def places(pairs: tuple[tuple[int, int], ...]) -> _Places:
            return tuple((place, tuple(t for t, _ in compiled.consumers[place])) for place, _ in pairs)

        rivals = tuple(dict.fromkeys(t for sharing in rule.enabling.contended[index] for t in sharing if t != index))
        return _Step(
            places(compiled.inputs[index]),
            places(compiled.outputs[last]),
            rivals,
            self.conflicts.alike((index, *rivals)),
            None if transition.guard is None else self.conflicts.guards[transition.guard.name],
            transition.guard is not None and transition.guard.negated,
            TransitionFired(transition.name),
            rule.notifier.foreseen(transition.origin, Phase.END if call is None else Phase.START),
            call,
            frozenset(place for place, _ in (*arcs, *(arc for rival in rivals for arc in compiled.inputs[rival]))),
            tuple(end.remote_outputs.items()),
        )

    def _is_plain(self, place: int) -> bool:
        """Whether tokens may come and go on a place without more than counting."""
        compiled, delayed = self.rule.enabling.compiled, self.conflicts.delayed
        consumers = compiled.consumers[place]
        return not compiled.inhibited[place] and all(weight == 1 and t not in delayed for t, weight in consumers)

    def _decide(self, index: int) -> bool:
        """Decides about a candidate; returns whether a transition fired."""
        if self.operator.free and index in self.conflicts.certain and not self.rule.held:
            self.fire(index, self.conflicts.first_owner(index))
            return True
        self.conflicts.barred = _NOTHING if self.operator.free else self.operator.barred
        if index in self.conflicts.delayed and self._delays.waits(index):
            return False
        if index in self.conflicts.barred:
            self._hold(index)
            return False
        winner = self.conflicts.choose(index)
        if winner is None:
            self._delays.give_up(index)
            return False
        if winner != index and index not in self.rule.enabling.stalled:
            self.rule.enabling.consider(index)
        self.fire(winner, self.conflicts.owner(winner))
        return True

    def _hold(self, index: int) -> None:
        """Keeps an enabled transition for the operator: to be confirmed, or until something may fire again."""
        if self.operator.asks and index in self.operator.written and self._may_fire(index):
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
        if self.rule.ledger.count and self.operator.free:
            drop_stale(self.rule)
            close_forgotten(self.rule)
        if self.operator.free and self._told == _BY_ITSELF:
            return
        self.operator.spent()
        told = (self.operator.mode, self.operator.paused, self.proposed())
        if told != self._told:
            self._told = told
            self.rule.notifier.operated(*told)

    def _watch_symbols(self) -> None:
        """Has symbols that have come to the tape expire."""
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
