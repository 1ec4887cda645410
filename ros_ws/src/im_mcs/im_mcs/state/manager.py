"""State manager (paper, section 4): enforces the table, and orders what a transition does over several ticks."""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, StateError, WaitTimeoutError
from im_mcs.limits.configuration import Servo
from im_mcs.protocol.requests import NOBODY, Sender
from im_mcs.state.reservation import Reservations
from im_mcs.state.table import ANYTIME, Event, State, next_state
from im_mcs.testbed.driver import Measured

OnEnd = Callable[[ImError | None], None]

_FRESH_TICKS = 2


class Arms(Protocol):
    """What the state manager asks of the layers above the slots."""

    def engage(self, groups: Sequence[str]) -> None:
        """Let the groups hold where they are measured to be."""
        ...

    def disengage(self) -> None:
        """No setpoints and no torques any more."""
        ...

    def drop_goals(self, reason: ImError) -> None:
        """End every goal with ``reason`` and :meth:`disengage`."""
        ...

    def moving(self) -> str | None:
        """A group that has a goal, if there is one."""
        ...

    def settled(self) -> bool:
        """Whether every engaged group is at rest, or has been given up on."""
        ...

    def broken(self) -> Sequence[str]:
        """What is broken now, as far as readings and hardware say; each in a few words."""
        ...


@dataclass
class _Running:
    event: Event
    steps: Generator[None, None, None]
    reply: OnEnd


class StateManager:
    """Present state, owners of the slots, and what power and brakes are told.

    Attributes:
        joints: Names of all joints.
        state: Present state.
        cause: Why MCS is in its state, though nobody asked for it; or empty.
        lost: Whether that is an emergency stop because the testbed was lost: it is over when the testbed is back.
        power: Power commanded.
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
        self.state = State.COLD
        self.cause = ""
        self.lost = False
        self.power = False
        self.brakes = np.ones(len(measured.q), dtype=np.bool_)
        self.reservations = Reservations(groups)
        self.measured = measured
        self._index = index
        self._arms = arms
        self._settings = settings
        self._running: _Running | None = None
        self._answer_ticks = round(settings.answer_timeout_s / settings.period_s)
        self._patience = 0

    @property
    def busy(self) -> bool:
        """Whether a transition is under way."""
        return self._running is not None

    @property
    def wants_time(self) -> bool:
        """Whether a transition is under way, or the testbed has yet to obey an emergency stop."""
        obeyed = not self.measured.power and bool(self.measured.brakes.all())
        return self.busy or (self._patience > 0 and not obeyed)

    def check(self, event: Event) -> State:
        """Where ``event`` leads from here.

        Raises:
            StateError: The table does not allow it, or another transition is under way.
        """
        target = next_state(self.state, event)
        if self._running is not None and event not in ANYTIME:
            raise StateError(
                f"{event.value} is refused while {self._running.event.value} is under way; wait for it, or estop",
                state=self.state.value,
                request=event.value,
            )
        return target

    def reserve(self, group: str, owner: str = "", lease_s: float = 0.0, sender: Sender = NOBODY) -> None:
        """Give a group its slots.

        Args:
            group: Name of the group.
            owner: Who uses it; empty: anyone.
            lease_s: Testbed time until it lapses unless renewed [s]; 0: never.
            sender: Who reserves it.

        Raises:
            StateError: Not allowed now, a slot is owned by another group, or does not answer.
            NotFoundError: There is no such group.
        """
        target = self.check(Event.RESERVE)
        self.reservations.reserve(group, owner, lease_s, self.measured.stamp_ns, sender)
        if not np.isfinite(self.measured.q[self._index[group]]).all():
            self.reservations.release(group)
            raise StateError(f"group '{group}' cannot be reserved: a slot of it gives no reading", group=group)
        self.state = target

    def take_over(self, group: str, owner: str, lease_s: float, sender: Sender) -> str:
        """Reserve a group for another owner than it has; arguments as :meth:`reserve`.

        Returns:
            Whose it was.

        Raises:
            StateError: Not allowed now, or the group is not reserved.
            NotFoundError: There is no such group.
        """
        self.check(Event.TAKE_OVER)
        return self.reservations.take_over(group, owner, lease_s, self.measured.stamp_ns, sender)

    def release(self, group: str, sender: Sender) -> None:
        """Take a group's slots back.

        Raises:
            StateError: Not allowed now, the group is not reserved, or ``sender`` is not its owner.
            NotFoundError: There is no such group.
        """
        self.check(Event.RELEASE)
        self.reservations.require_owner(group, sender)
        self._free(group)

    def _free(self, group: str) -> None:
        self.reservations.release(group)
        self.state = next_state(self.state, Event.RELEASE if self.reservations.groups else Event.RELEASE_LAST)

    def renew(self, owner: str) -> None:
        """Let the leases of an owner run anew.

        Raises:
            StateError: Not allowed now, or the owner has reserved nothing.
        """
        self.check(Event.RENEW)
        self.reservations.renew(owner, self.measured.stamp_ns)

    def check_repartition(self, groups: Mapping[str, Sequence[str]], preset: str) -> None:
        """Check that the slots may be divided into other groups.

        Args:
            groups: Slots of each group.
            preset: Name of the partition, for messages.

        Raises:
            StateError: Not allowed now, or a reserved group has other joints there.
        """
        self.check(Event.REPARTITION)
        self.reservations.check_repartition(groups, preset)

    def repartition(self, groups: Mapping[str, Sequence[str]], index: Mapping[str, NDArray[np.intp]]) -> None:
        """Divide the slots into other groups; to be checked before.

        Args:
            groups: Slots of each group.
            index: Joints of each group, as ranks.
        """
        self.reservations.repartition(groups)
        self._index = index

    def shut_down(self, reason: str) -> None:
        """Go towards power off by the ordinary ways, as soon as nothing moves; to be called tick by tick."""
        if self._running is None and self._arms.moving() is None:
            self.cause = reason
            if self.state is State.MOTION:
                self.begin(Event.DISABLE_MOTION, lambda error: None)
            elif self.state is State.ACTIVE:
                self.begin(Event.POWER_OFF, lambda error: None)

    def begin(self, event: Event, reply: OnEnd) -> None:
        """Start a transition that goes on in :meth:`tick`; ``reply`` is called at its end.

        Raises:
            StateError: Not allowed now.
        """
        target = self.check(event)
        if event is Event.DISABLE_MOTION and (group := self._arms.moving()) is not None:
            raise StateError(
                f"disable_motion is refused while group '{group}' moves; cancel the motion or wait for its end",
                group=group,
            )
        if event in (Event.RESET, Event.POWER_ON):
            self._require_secured(event)
        steps = {
            Event.POWER_ON: self._power_on,
            Event.POWER_OFF: self._power_off,
            Event.ENABLE_MOTION: self._enable_motion,
            Event.DISABLE_MOTION: self._disable_motion,
            Event.RESET: self._reset,
        }[event]
        if event is Event.POWER_ON:
            self.cause = ""
        self._running = _Running(event, steps(target), reply)

    def tick(self) -> None:
        """Go on with the transition that is under way; free what a dead client has reserved."""
        running = self._running
        self._patience = max(0, self._patience - 1)
        if running is None:
            if self.state is State.RESERVED:
                self._free_lapsed()
            return
        try:
            next(running.steps)
        except StopIteration:
            self._running = None
            running.reply(None)
        except ImError as error:
            self._running = None
            running.reply(error)

    def estop(self, reason: str, **facts: object) -> None:
        """Stop at once: setpoints dropped, goals ended, brakes on, power off; latched.

        There is no state in which it is refused; after another one, the cause is that of the first.

        Args:
            reason: Why.
            **facts: Named values the reason speaks of.
        """
        target = self.check(Event.ESTOP)
        error = StateError(f"emergency stop: {reason}", reason=reason)
        error.facts.update(facts)
        running, self._running = self._running, None
        self.lost = False
        if self.state is not State.ESTOPPED:
            self.state = target
            self.cause = reason
            self._patience = self._answer_ticks
            self.power = False
            self.brakes = np.ones_like(self.brakes)
            self._arms.drop_goals(error)
        if running is not None:
            running.steps.close()
            running.reply(error)

    def _require_secured(self, event: Event) -> None:
        """Check that power is off and every brake holds; joints with an open brake are named."""
        if self.measured.power:
            raise StateError(f"{event.value} is refused: the testbed still reports power on", request=event.value)
        if not self.measured.brakes.all():
            which = self._named(np.flatnonzero(~self.measured.brakes))
            sentence = f"{event.value} is refused: the testbed reports the brake open of {which}"
            raise StateError(sentence, request=event.value, joints=which)

    def _named(self, ranks: NDArray[np.intp]) -> str:
        """Names of the joints with these ranks."""
        return ", ".join(self.joints[rank] for rank in ranks)

    def _reserved_joints(self) -> NDArray[np.intp]:
        """Ranks of all joints of reserved groups."""
        return np.concatenate([self._index[group] for group in self.reservations.groups])

    def _free_lapsed(self) -> None:
        self.reservations.lapse(self.measured.stamp_ns)
        for group in self.reservations.lapsed():
            self._free(group)

    # what a transition does over several ticks: each yields once a tick

    def _fail(self, reason: str) -> None:
        """An e-stop because of the transition that is under way; its reply says what happened."""
        self._running = None
        self.estop(reason)

    def _power_on(self, target: State) -> Generator[None, None, None]:
        """Power on, brakes on."""
        self.power = True
        try:
            yield from self._until(lambda: self.measured.power, lambda: "the testbed to switch power on")
        except WaitTimeoutError:
            self.power = False
            raise
        self.state = target

    def _power_off(self, target: State) -> Generator[None, None, None]:
        """Power off; if it stays on, an e-stop."""
        self.power = False
        try:
            yield from self._until(lambda: not self.measured.power, lambda: "the testbed to switch power off")
        except WaitTimeoutError as error:
            self._fail(f"power is not obeyed: {error.message}")
            raise
        self.state = target

    def _enable_motion(self, target: State) -> Generator[None, None, None]:
        """Torque carries the arm before the brakes let go; then until all is at rest."""
        joints = self._reserved_joints()
        self._arms.engage(self.reservations.groups)
        yield from self._ticks(self._settings.brake_lead_ticks)
        self.brakes[joints] = False
        try:
            yield from self._until_moved(joints, engaged=False)
        except WaitTimeoutError as error:
            self.brakes[joints] = True
            yield from self._until_braked(joints, error)
            self._arms.disengage()
            raise
        self.state = target
        while not self._arms.settled():
            yield

    def _disable_motion(self, target: State) -> Generator[None, None, None]:
        """Brakes hold before the torque leaves; if they do not, it goes on carrying the arm."""
        joints = self._reserved_joints()
        self.brakes[joints] = True
        try:
            yield from self._until_braked(joints)
        except WaitTimeoutError:
            self.brakes[joints] = False
            raise
        self._arms.disengage()
        self.state = target

    def _until_braked(
        self, joints: NDArray[np.intp], cause: WaitTimeoutError | None = None
    ) -> Generator[None, None, None]:
        """Brakes hold before the torque leaves.

        Args:
            joints: Which, as ranks.
            cause: What failed before; if the brakes fail too, power must go.
        """
        try:
            yield from self._until_moved(joints, engaged=True)
        except WaitTimeoutError as error:
            if cause is not None:
                self._fail(f"brakes are not obeyed: {cause.message}; {error.message}")
            raise
        yield from self._ticks(self._settings.brake_lead_ticks)

    def _reset(self, target: State) -> Generator[None, None, None]:
        """Forget reservations and cause, if nothing is broken; nothing moves.

        What is judged are readings from after the request: of what has just been mended, the present ones are old.
        """
        yield from self._ticks(_FRESH_TICKS)
        if broken := ", ".join(self._arms.broken()):
            sentence = f"reset is refused while there is {broken}; the cause of the stop: {self.cause}"
            raise StateError(sentence, request=Event.RESET.value, broken=broken)
        self.reservations.release_all()
        self.cause, self.lost = "", False
        self.state = target

    @staticmethod
    def _ticks(count: int) -> Generator[None, None, None]:
        for _ in range(count):
            yield

    def _until_moved(self, joints: NDArray[np.intp], engaged: bool) -> Generator[None, None, None]:
        """Until the brakes of ``joints`` report to be as they are told; else the error names those that do not."""

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
