"""State manager (paper, section 4): enforces the table, and orders the steps of a transition over several ticks.

Transitions of different groups go on beside each other. Brakes are a group's own; power is one for all, and on while
any group needs it.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, StateError, WaitTimeoutError
from im_mcs.limits.configuration import Servo
from im_mcs.protocol.requests import NOBODY, Sender
from im_mcs.state.reservation import Reservations
from im_mcs.state.table import ANYTIME, POWERED, Event, State, allows, highest, next_state
from im_mcs.testbed.driver import Measured

OnEnd = Callable[[ImError | None], None]
Enter = Callable[[], None]
"""The groups of a transition come to the state that it leads to."""

_FRESH_TICKS = 2
_NO_FACTS: Mapping[str, object] = {}


class Arms(Protocol):
    """Layers above the slots, from the state manager's view."""

    def engage(self, groups: Sequence[str]) -> None:
        """Let the groups hold the measured place."""
        ...

    def disengage(self, groups: Sequence[str]) -> None:
        """No setpoints and no torques of the groups any more."""
        ...

    def drop_goals(self, reason: ImError) -> None:
        """End every goal with ``reason`` and :meth:`disengage` all groups; senders are told when the power is gone."""
        ...

    def forget_stop(self) -> None:
        """Let no later process begin with the emergency stop being reset.

        Raises:
            StoreError: The mark of the stop cannot be removed.
        """
        ...

    def end_goals(self, groups: Sequence[str], reason: ImError) -> None:
        """End the goals of groups with ``reason``; what moves decelerates on its path."""
        ...

    def moving(self, groups: Sequence[str]) -> str | None:
        """Return one of the groups with a goal, if there is one."""
        ...

    def settled(self, groups: Sequence[str]) -> bool:
        """Whether the groups, which are engaged, are at rest, or have been given up on."""
        ...

    def broken(self) -> Sequence[str]:
        """Return the present faults of readings and hardware, each in a few words."""
        ...


@dataclass(eq=False)
class _Running:
    event: Event
    groups: Sequence[str]
    steps: Generator[None, None, None]
    reply: OnEnd


class StateManager:
    """State and owner of every group, with the commands to power and brakes.

    Attributes:
        state: State of the machine: the highest that any group is in; estopped after an emergency stop.
        states: States of the groups that are not cold; another object after every change.
        joints: Names of all joints.
        cause: Why MCS is in its state, though nobody asked for it; or empty.
        lost: Whether that is an emergency stop because the testbed was lost: it is over when the testbed is back.
        brakes: Brakes commanded, shape (n,).

    Args:
        joints: Names of all joints.
        groups: Slots of each group.
        index: Joints of each group, as ranks.
        settings: Times of the sequences.
        measured: State measured first.
        arms: The layers above the slots.
    """

    def __init__(
        self,
        joints: Sequence[str],
        groups: Mapping[str, Sequence[str]],
        index: Mapping[str, NDArray[np.intp]],
        settings: Servo,
        measured: Measured,
        arms: Arms,
    ) -> None:
        self.joints = joints
        self.cause = ""
        self.lost = False
        self.brakes = np.ones(len(measured.q), dtype=np.bool_)
        self.reservations = Reservations(groups)
        self.measured = measured
        self._index = index
        self._arms = arms
        self._settings = settings
        self._stopped = False
        self._states: dict[str, State] = {}
        self._judge_states()
        self._needing: set[str] = set()
        self._running: list[_Running] = []
        self._answer_ticks = round(settings.answer_timeout_s / settings.period_s)
        self._patience = 0

    def state_of(self, group: str) -> State:
        """Return the state of a group: cold unless reserved; estopped after an emergency stop."""
        return State.ESTOPPED if self._stopped else self._states.get(group, State.COLD)

    @property
    def power(self) -> bool:
        """Commanded power: true if any group needs power."""
        return bool(self._needing)

    @property
    def busy(self) -> bool:
        """Whether a transition is under way."""
        return bool(self._running)

    @property
    def wants_time(self) -> bool:
        """Whether a transition is under way, or the testbed has yet to obey an emergency stop."""
        m = self.measured
        return self.busy or (self._patience > 0 and (m.power or not m.brakes.all()))

    def check(self, event: Event, group: str = "") -> State:
        """Where ``event`` leads from here.

        Args:
            event: What is asked for.
            group: The group that it concerns; empty: the machine.

        Raises:
            StateError: The table does not allow it, the group is not reserved, or a transition is under way.
            NotFoundError: There is no such group.
        """
        if group and self.state not in (State.COLD, State.ESTOPPED):
            self.reservations.require(group)
            target = self._next(self._states[group], event, group)
        else:
            target = self._next(self.state, event)
        self._require_idle(event, (group,) if group else ())
        return target

    def allowed(self, event: Event, sender: Sender | None = None) -> list[str]:
        """Return groups, in the order of the reservation, in a state with a row of the table for ``event``.

        Args:
            event: What is asked for.
            sender: Whose groups; None: everybody's.

        Raises:
            StateError: There are none, or none but those of another owner, who is named.
        """
        own = [group for group in self._states if sender is None or self._disposes(event, group, sender)]
        if mine := [group for group in own if allows(self.state_of(group), event)]:
            return mine
        if not own and sender is not None:
            for group in self._states:
                if allows(self.state_of(group), event):
                    self.reservations.require_owner(group, sender)
        self._next(highest(map(self.state_of, own)) if own else self.state, event)
        return mine

    def _next(self, state: State, event: Event, group: str = "") -> State:
        return next_state(state, event, group, self.cause)

    def _disposes(self, event: Event, group: str, sender: Sender) -> bool:
        """Return whether the sender may change a group; with a lapsed lease, anyone may disable motion and power."""
        given_up = event in (Event.DISABLE_MOTION, Event.POWER_OFF) and self.reservations.has_lapsed(
            group, self.measured.stamp_ns
        )
        return given_up or self.reservations.disposes(group, sender)

    def under_way(self) -> set[str]:
        """Return groups with a transition under way."""
        return {group for running in self._running for group in running.groups}

    def _require_idle(self, event: Event, groups: Sequence[str]) -> None:
        """Check for no running transition of the groups; without groups, for an idle group allowing the event."""
        if event in ANYTIME or not self._running:
            return
        under_way = self.under_way()
        if groups and not under_way & set(groups):
            return
        if not groups and any(allows(self._states[g], event) for g in self._states if g not in under_way):
            return
        running = next((r for r in self._running if set(r.groups) & set(groups)), self._running[0])
        raise StateError(
            f"{event.value} is refused while {running.event.value} is under way; wait for it, or estop",
            state=self.state.value,
            request=event.value,
        )

    def reserve(self, group: str, owner: str = "", lease_s: float = 0.0, sender: Sender = NOBODY) -> None:
        """Give a group the slots.

        Args:
            group: Name of the group.
            owner: Who uses it; empty: anyone.
            lease_s: Testbed time until it lapses unless renewed [s]; 0: never.
            sender: Who reserves it.

        Raises:
            StateError: Not allowed now, a slot is owned by another group, or does not answer.
            NotFoundError: There is no such group.
        """
        target = self._next(State.ESTOPPED if self._stopped else State.COLD, Event.RESERVE)
        self.reservations.reserve(group, owner, lease_s, self.measured.stamp_ns, sender)
        if not np.isfinite(self.measured.q[self._index[group]]).all():
            self.reservations.release(group)
            raise StateError(f"group '{group}' cannot be reserved: a slot of it gives no reading", group=group)
        self._states[group] = target
        self._judge_states()

    def take_over(self, group: str, owner: str, lease_s: float, sender: Sender) -> str:
        """Reserve a group for another owner than the present one; arguments as :meth:`reserve`.

        Returns:
            Whose it was.

        Raises:
            StateError: Not allowed now, or the group is not reserved.
            NotFoundError: There is no such group.
        """
        self.check(Event.TAKE_OVER, group)
        return self.reservations.take_over(group, owner, lease_s, self.measured.stamp_ns, sender)

    def release(self, group: str, sender: Sender, reply: OnEnd) -> None:
        """Start to take a group's slots back, as :meth:`begin`: its goals end, motion and power go first.

        Raises:
            StateError: Not allowed now, the group is not reserved, or ``sender`` is not its owner.
            NotFoundError: There is no such group.
        """
        self.check(Event.RELEASE, group)
        self.reservations.require_owner(group, sender)
        if self._states[group] in POWERED:
            self._running.append(_Running(Event.RELEASE, (group,), self._release(group), reply))
        else:
            self._free(group)
            reply(None)

    def _free(self, group: str) -> None:
        self.reservations.release(group)
        del self._states[group]
        self._judge_states()

    def renew(self, owner: str) -> None:
        """Let the leases of an owner run anew.

        Raises:
            StateError: Not allowed now, or the owner has reserved nothing.
        """
        self.check(Event.RENEW)
        self.reservations.renew(owner, self.measured.stamp_ns)

    def check_repartition(
        self, groups: Mapping[str, Sequence[str]], preset: str, sender: Sender
    ) -> dict[str, list[str]]:
        """Check whether the slots may be divided into other groups.

        Returns:
            The groups that will be reserved in the place of others, each with those others.

        Raises:
            StateError: Not allowed now, or not with the groups that are reserved.
        """
        self.check(Event.REPARTITION)
        heirs = self.reservations.heirs(groups, preset, sender)
        for heir, former in heirs.items():
            self._require_idle(Event.REPARTITION, former)
            states = {self._states[group] for group in former}
            if len(states) > 1:
                each = ", ".join(f"'{group}' is {self._states[group].value}" for group in former)
                raise StateError(f"repartition to {preset} is refused: of the joints of group '{heir}' there, {each}")
            if State.MOTION in states and not (self._arms.moving(former) is None and self._arms.settled(former)):
                named = ", ".join(f"'{group}'" for group in former)
                raise StateError(f"repartition to {preset} is refused: {named} not at rest", groups=former)
        return heirs

    def repartition(
        self,
        groups: Mapping[str, Sequence[str]],
        index: Mapping[str, NDArray[np.intp]],
        heirs: Mapping[str, Sequence[str]],
    ) -> None:
        """Divide the slots into other groups; power and brakes stay as they are.

        Args:
            groups: Slots of each group.
            index: Joints of each group, as ranks.
            heirs: What :meth:`check_repartition` returned.
        """
        self.reservations.repartition(groups, heirs)
        states = {heir: self._states[former[0]] for heir, former in heirs.items()}
        needing = {heir for heir, former in heirs.items() if former[0] in self._needing}
        gone = {group for former in heirs.values() for group in former}
        self._states = {group: state for group, state in self._states.items() if group not in gone} | states
        self._needing = (self._needing - gone) | needing
        self._index = index
        self._judge_states()

    def shut_down(self, reason: str) -> None:
        """Go towards power off by the ordinary ways, as soon as nothing moves; to be called tick by tick."""
        if not self._running and self._arms.moving(self.reservations.groups) is None:
            self.cause = reason
            for event in (Event.DISABLE_MOTION, Event.POWER_OFF):
                if groups := [group for group in self._states if allows(self.state_of(group), event)]:
                    self._begin(event, groups, lambda error: None)
                    return

    def begin(self, event: Event, reply: OnEnd, group: str = "", sender: Sender = NOBODY) -> None:
        """Start a transition continued in :meth:`tick`; ``reply`` is called at the end.

        Args:
            event: Of :data:`~im_mcs.state.table.TRANSITIONS`.
            reply: Told why it failed, or None.
            group: Which group; empty: all that are the sender's and in the state from which it leads.
            sender: Who asks.

        Raises:
            StateError: Not allowed now, or to somebody else only, who is named.
            NotFoundError: There is no such group.
        """
        if group:
            self.check(event, group)
            if not self._disposes(event, group, sender):
                self.reservations.require_owner(group, sender)
            groups = [group]
        else:
            groups = self.allowed(event, sender)
            self._require_idle(event, groups)
        self._begin(event, groups, reply)

    def reset(self, reply: OnEnd) -> None:
        """Start to end an emergency stop, as :meth:`begin`; nothing moves.

        Raises:
            StateError: There is none, or a reset is under way.
        """
        self.check(Event.RESET)
        self._running.append(_Running(Event.RESET, (), self._reset(), reply))

    def _begin(self, event: Event, groups: Sequence[str], reply: OnEnd) -> None:
        steps = {
            Event.POWER_ON: self._power_on,
            Event.POWER_OFF: self._power_off,
            Event.ENABLE_MOTION: self._enable_motion,
            Event.DISABLE_MOTION: self._disable_motion,
        }[event]
        target = self._next(self.state_of(groups[0]), event)
        enter = partial(self._enter, groups, target)
        self._running.append(_Running(event, groups, steps(groups, enter), reply))

    def _enter(self, groups: Sequence[str], state: State) -> None:
        self._states.update(dict.fromkeys(groups, state))
        self._judge_states()

    def _judge_states(self) -> None:
        """Keep values looked at several times a tick and rarely changed."""
        self.states = dict.fromkeys(self._states, State.ESTOPPED) if self._stopped else self._states.copy()
        self.state = State.ESTOPPED if self._stopped else highest(self._states.values())

    def tick(self) -> None:
        """Go on with the transitions under way; free the reservations of a dead client."""
        if self._patience > 0:
            self._patience -= 1
        self._free_lapsed()
        for running in tuple(self._running):
            if running not in self._running:
                continue  # an emergency stop that another one led to has ended it
            try:
                next(running.steps)
            except StopIteration:
                self._end(running, None)
            except ImError as error:
                self._end(running, error)

    def _end(self, running: _Running, error: ImError | None) -> None:
        if running in self._running:
            self._running.remove(running)
        running.reply(error)

    def estop(self, reason: str, facts: Mapping[str, object] = _NO_FACTS) -> None:
        """Stop at once: setpoints dropped, goals ended, brakes on, power off; latched.

        There is no state in which it is refused; after another one, the cause is that of the first.
        """
        self.check(Event.ESTOP)
        error = StateError(f"emergency stop: {reason}", reason=reason)
        error.facts.update(facts)
        ended, self._running = self._running, []
        self.lost = False
        if not self._stopped:
            self._stopped = True
            self._judge_states()
            self.cause = reason
            self._patience = self._answer_ticks
            self._needing.clear()
            self.brakes = np.ones_like(self.brakes)
            self._arms.drop_goals(error)
        for running in ended:
            running.steps.close()
            running.reply(error)

    def _require_secured(self, event: Event, joints: NDArray[np.intp] | None) -> None:
        """Check whether the brakes of ``joints`` hold; without any, of all joints, with power off.

        Raises:
            StateError: Power is on, or a brake open; joints with an open brake are named.
        """
        switching_off = any(running.event is Event.POWER_OFF for running in self._running)
        if joints is None and self.measured.power and not switching_off:
            raise StateError(f"{event.value} is refused: the testbed still reports power on", request=event.value)
        looked_at = np.arange(len(self.joints)) if joints is None else joints
        if not self.measured.brakes[looked_at].all():
            which = self._named(looked_at[~self.measured.brakes[looked_at]])
            sentence = f"{event.value} is refused: the testbed reports the brake open of {which}"
            raise StateError(sentence, request=event.value, joints=which)

    def _secure(self, event: Event, joints: NDArray[np.intp] | None) -> Generator[None, None, None]:
        """Give commanded brakes the time to hold, then :meth:`_require_secured`."""
        looked_at = np.arange(len(self.joints)) if joints is None else joints
        with suppress(WaitTimeoutError):
            yield from self._until(lambda: bool(self.measured.brakes[looked_at].all()), str)
        self._require_secured(event, joints)

    def _named(self, ranks: NDArray[np.intp]) -> str:
        """Return names of the joints with the given ranks."""
        return ", ".join(self.joints[rank] for rank in ranks)

    def _joints(self, groups: Sequence[str]) -> NDArray[np.intp]:
        """Return ranks of all joints of groups."""
        return np.concatenate([self._index[group] for group in groups])

    def _free_lapsed(self) -> None:
        """Free groups without power and with an expired lease."""
        for group, state in self.states.items():
            lapsed = state is State.RESERVED and self.reservations.has_lapsed(group, self.measured.stamp_ns)
            if lapsed and group not in self.under_way():
                self._free(group)

    # what a transition does over several ticks: each yields once a tick

    def _fail(self, groups: Sequence[str], reason: str) -> None:
        """Do an e-stop for the failed transition of the groups; the reply gives the reason."""
        self._running = [running for running in self._running if running.groups is not groups]
        self.estop(reason)

    def _power_on(self, groups: Sequence[str], enter: Enter) -> Generator[None, None, None]:
        """Switch power on, with brakes on; power just released by another group must have gone before."""
        yield from self._secure(Event.POWER_ON, self._joints(groups) if self.power else None)
        self.cause = ""
        secured = "the testbed to switch power off first"
        yield from self._until(lambda: self.power or not self.measured.power, lambda: secured)
        self._needing.update(groups)
        try:
            yield from self._until(lambda: self.measured.power, self._awaited_power)
        except WaitTimeoutError:
            self._needing.difference_update(groups)
            raise
        enter()

    def _awaited_power(self) -> str:
        return ": ".join(filter(None, ("the testbed to switch power on", ", ".join(self._arms.broken()))))

    def _power_off(self, groups: Sequence[str], enter: Enter) -> Generator[None, None, None]:
        """Disable motion, then switch power off, unless another group needs it; if it stays on, do an e-stop."""
        if moves := [group for group in groups if self._states[group] is State.MOTION]:
            yield from self._disable_motion(moves, partial(self._enter, moves, State.ACTIVE))
        self._needing.difference_update(groups)
        try:
            yield from self._until(
                lambda: self.power or not self.measured.power, lambda: "the testbed to switch power off"
            )
        except WaitTimeoutError as error:
            self._fail(groups, f"power is not obeyed: {error.message}")
            raise
        enter()

    def _enable_motion(self, groups: Sequence[str], enter: Enter) -> Generator[None, None, None]:
        """Torque carries the arm before the brakes let go; then until all is at rest."""
        joints = self._joints(groups)
        self._arms.engage(groups)
        yield from self._ticks(self._settings.brake_lead_ticks)
        self.brakes[joints] = False
        try:
            yield from self._until_moved(joints, engaged=False)
        except WaitTimeoutError as error:
            self.brakes[joints] = True
            yield from self._until_braked(groups, error)
            self._arms.disengage(groups)
            raise
        enter()
        while not self._arms.settled(groups):
            yield

    def _disable_motion(self, groups: Sequence[str], enter: Enter) -> Generator[None, None, None]:
        """End goals, engage brakes, then take the torque; if a brake does not hold, it goes on carrying the arm."""
        if self._arms.moving(groups) is not None:
            self._arms.end_goals(groups, StateError("the motion was ended: motion of its group is being disabled"))
            while self._arms.moving(groups) is not None or not self._arms.settled(groups):
                yield
        joints = self._joints(groups)
        self.brakes[joints] = True
        try:
            yield from self._until_braked(groups)
        except WaitTimeoutError:
            self.brakes[joints] = False
            raise
        self._arms.disengage(groups)
        enter()

    def _release(self, group: str) -> Generator[None, None, None]:
        """Take the power of a group, then free the slots."""
        yield from self._power_off((group,), partial(self._enter, (group,), State.RESERVED))
        self._free(group)

    def _until_braked(
        self, groups: Sequence[str], cause: WaitTimeoutError | None = None
    ) -> Generator[None, None, None]:
        """Wait for the brakes to hold, before the torque leaves.

        Args:
            groups: Whose.
            cause: What failed before; if the brakes fail too, power must go.
        """
        try:
            yield from self._until_moved(self._joints(groups), engaged=True)
        except WaitTimeoutError as error:
            if cause is not None:
                self._fail(groups, f"brakes are not obeyed: {cause.message}; {error.message}")
            raise
        yield from self._ticks(self._settings.brake_lead_ticks)

    def _reset(self) -> Generator[None, None, None]:
        """Forget reservations and cause, if nothing is broken; nothing moves.

        What is judged are readings from after the request: of what has just been mended, the present ones are old.
        """
        yield from self._ticks(_FRESH_TICKS)
        yield from self._secure(Event.RESET, None)
        if broken := ", ".join(self._arms.broken()):
            sentence = f"reset is refused while there is {broken}; the cause of the stop: {self.cause}"
            raise StateError(sentence, request=Event.RESET.value, broken=broken)
        self._arms.forget_stop()
        self.reservations.release_all()
        self._states.clear()
        self.cause, self.lost = "", False
        self._stopped = False
        self._judge_states()

    @staticmethod
    def _ticks(count: int) -> Generator[None, None, None]:
        for _ in range(count):
            yield

    def _until_moved(self, joints: NDArray[np.intp], engaged: bool) -> Generator[None, None, None]:
        """Wait until the brakes of ``joints`` report the command; else name the failing ones in the error."""

        def not_yet() -> NDArray[np.intp]:
            moved: NDArray[np.bool_] = self.measured.brakes[joints] == engaged
            return joints[~moved]

        verb = "engage" if engaged else "release"
        yield from self._until(
            lambda: not not_yet().size,
            lambda: f"the brakes to {verb}, those of {self._named(not_yet())}",
        )

    def _until(self, holds: Callable[[], bool], what: Callable[[], str]) -> Generator[None, None, None]:
        timeout_s = self._settings.answer_timeout_s
        for _ in range(self._answer_ticks):
            if holds():
                return
            yield
        raise WaitTimeoutError(what=what(), seconds=timeout_s)
