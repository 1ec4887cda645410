"""The loop of a net: takes events, decides, fires, and lets time strike."""

from collections import deque
from collections.abc import Callable
from functools import partial

from im_pnt.acting import Actions
from im_pnt.choosing import Chooser
from im_pnt.delays import Delays
from im_pnt.events import Event, Observer
from im_pnt.expand import active_place
from im_pnt.fastloop import FastLoop
from im_pnt.firing import FiringRule
from im_pnt.handling import handle
from im_pnt.modes import Mode, Operator
from im_pnt.net import Role
from im_pnt.timers import Timers

_NOTHING: frozenset[int] = frozenset()
_BY_ITSELF = (Mode.AUTOMATIC, False, ())


class Operation:
    """What happens in the loop of one net.

    Args:
        rule: The marking, and what firing does to it.
        chooser: Decides about contending transitions.
        actions: Has actions done.
        timers: What is to happen at a time.
        inbox: Events that wait.
        clock: Present time [s].

    Attributes:
        rule: As given.
        chooser: As given.
        actions: As given.
        operator: How the net is operated.
    """

    def __init__(
        self,
        rule: FiringRule,
        chooser: Chooser,
        actions: Actions,
        timers: Timers,
        inbox: deque[Event],
        clock: Callable[[], float],
    ) -> None:
        self.rule, self.chooser, self.actions = rule, chooser, actions
        roles = [transition.role for transition in rule.transitions]
        written = (index for index, role in enumerate(roles) if role in (Role.PLAIN, Role.START))
        self.operator = Operator(written, (index for index, role in enumerate(roles) if role is Role.ACCEPT))
        self._timers, self._inbox, self._clock = timers, inbox, clock
        self._delays = Delays(rule.transitions, rule.enabling, chooser, timers, clock)
        self._observed = getattr(rule.teller.observer.fired, "__func__", None) is not Observer.fired
        self._fast: FastLoop | None = None
        self._pumping = False
        self._closed = 0
        self._guard_clocks: set[str] = set()
        self._told: tuple[Mode, bool, tuple[str, ...]] = (self.operator.mode, self.operator.paused, ())

    @property
    def due(self) -> bool:
        """Whether an event or a decision waits; not while they are being dealt with."""
        return not self._pumping and bool(self._inbox or self.rule.enabling.agenda)

    @property
    def calling(self) -> str:
        """The transition whose function is being called without ceremony, empty if none is."""
        fast = self._fast
        return self.rule.transitions[fast.calling].origin if fast is not None and fast.calling >= 0 else ""

    def marking(self) -> dict[str, int]:
        """Returns the marked places by name."""
        marking = self.rule.tokens.marking()
        if self.calling:
            active = active_place(self.calling)
            marking[active] = marking.get(active, 0) + 1
        return marking

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
        try:
            if self._timers.next() is not None:
                self._strike()
            return self._pump(limit)
        finally:
            self._pumping = False

    def strike(self) -> None:
        """Does what is due by the clock."""
        if not self._pumping:
            self._strike()

    def fire(self, index: int) -> None:
        """Fires a transition and begins its action."""
        activity = self.rule.fire(index)
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
            self.rule.teller.troubled(f"transition {name} was confirmed, but it is not proposed")
            return
        del self.operator.proposed[index]
        if self._may_fire(index):
            self.fire(index)
        else:
            self.rule.teller.troubled(f"transition {name} was confirmed, but it cannot fire any more")

    def resume(self) -> None:
        """Goes on after a journal was replayed."""
        self.chooser.reseed(self.rule.teller.sequence)
        self.actions.resume()

    def _pump(self, limit: int) -> bool:
        fired, inbox, enabling = 0, self._inbox, self.rule.enabling
        while fired < limit:
            if inbox:
                handle(self, inbox.popleft())
                if enabling.stalled or enabling.crossed or not self.operator.free:
                    self._after_event()
                continue
            if not self._observed and self._may_hurry():
                fired += self._hurry(limit - fired)
                if inbox or fired >= limit:
                    continue
            index = enabling.next_candidate() if enabling.agenda else None
            if index is None:
                self._come_to_rest()
                return bool(inbox)
            fired += self._decide(index)
        return True

    def _strike(self) -> None:
        if self._timers.strike(self._clock()):
            self._after_event()

    def _after_event(self) -> None:
        self.chooser.wake_undeclared()
        self._delays.settle()
        if not self.operator.free:
            self.release()

    def release(self) -> None:
        """Decides again about what was held back or proposed."""
        for index in self.operator.release():
            self.rule.enabling.consider(index)

    # Deciding.

    def _may_hurry(self) -> bool:
        rule = self.rule
        if rule.record is not None or not self.operator.free or rule.ledger.serving is not None:
            return False
        closed = rule.ledger.count - len(rule.ledger)
        if rule.tokens.queues and closed != self._closed:
            rule.tokens.forget_jobs(rule.ledger.is_open)
            self._closed = closed
        return not rule.tokens.queues

    def _hurry(self, limit: int) -> int:
        if self._fast is None:
            self._fast = FastLoop(self.rule, self.chooser, self._inbox, self.actions, self.fire)
        return self._fast.run(limit)

    def _decide(self, index: int) -> bool:
        """Decides about a candidate; returns whether a transition fired."""
        if self.operator.free and index in self.chooser.certain:
            self.fire(index)
            return True
        self.chooser.barred = _NOTHING if self.operator.free else self.operator.barred
        if index in self.chooser.delayed and self._delays.waits(index):
            return False
        if index in self.chooser.barred:
            self._hold(index)
            return False
        winner = self.chooser.choose(index)
        if winner is None:
            self._delays.give_up(index)
            return False
        if winner != index and index not in self.rule.enabling.stalled:
            self.rule.enabling.consider(index)
        self.fire(winner)
        return True

    def _hold(self, index: int) -> None:
        """Keeps an enabled transition for the operator: to be confirmed, or until something may fire again."""
        if self.operator.asks and index in self.operator.written and self._may_fire(index):
            self.operator.proposed[index] = None
        elif index not in self.rule.enabling.stalled:
            self.operator.hold(index)

    def _may_fire(self, index: int) -> bool:
        self.chooser.barred = frozenset()
        return self.chooser.may_fire(index)

    # Coming to rest.

    def _come_to_rest(self) -> None:
        if self.chooser.clocks:
            self._arm_guard_clocks()
        if self.rule.ledger.count and self.operator.free:
            self.rule.close_forgotten()
        if self.operator.free and self._told == _BY_ITSELF:
            return
        self.operator.spent()
        told = (self.operator.mode, self.operator.paused, self.proposed())
        if told != self._told:
            self._told = told
            self.rule.teller.operated(*told)

    def _arm_guard_clocks(self) -> None:
        for source, period in self.chooser.clocks.items():
            if source not in self._guard_clocks and self.chooser.stalls(source):
                self._guard_clocks.add(source)
                self._timers.at(self._clock() + period, partial(self._tick, source))

    def _tick(self, source: str) -> None:
        self._guard_clocks.discard(source)
        self.chooser.wake(source)
