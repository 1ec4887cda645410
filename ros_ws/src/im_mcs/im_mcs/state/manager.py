"""State manager (paper, section 4): enforces the table, and orders what a transition does over several ticks."""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, StateError, WaitTimeoutError
from im_mcs.config import Servo
from im_mcs.state.reservation import Reservations
from im_mcs.state.table import Event, State, next_state
from im_mcs.testbed.driver import Measured

Reply = Callable[[ImError | None], None]


class Arms(Protocol):
    """What the state manager asks of the layers above the slots."""

    def engage(self, groups: Sequence[str]) -> None:
        """Let the groups hold where they are measured to be."""
        ...

    def disengage(self) -> None:
        """No setpoints and no torques any more."""
        ...

    def drop(self, reason: ImError) -> None:
        """End every goal with ``reason`` and :meth:`disengage`."""
        ...

    def moving(self) -> str | None:
        """A group that has a goal, if there is one."""
        ...

    def settled(self) -> bool:
        """Whether every engaged group is at rest, or has been given up on."""
        ...


@dataclass
class _Running:
    event: Event
    steps: Generator[None, None, None]
    reply: Reply


class StateManager:
    """Present state, owners of the slots, and what power and brakes are told.

    Attributes:
        state: Present state.
        cause: Why MCS is estopped, or empty.
        power: Power commanded.
        brakes: Brakes commanded, shape (n,).

    Args:
        groups: Slots of each group.
        index: Joints of each group, as ranks.
        settings: Times of the sequences.
        measured: State measured first.
        arms: The layers above the slots.
    """

    def __init__(
        self,
        groups: Mapping[str, Sequence[str]],
        index: Mapping[str, NDArray[np.intp]],
        settings: Servo,
        measured: Measured,
        arms: Arms,
    ) -> None:
        self.state = State.COLD
        self.cause = ""
        self.power = False
        self.brakes = np.ones(len(measured.q), dtype=np.bool_)
        self.reservations = Reservations(groups)
        self.measured = measured
        self._index = index
        self._settings = settings
        self._arms = arms
        self._running: _Running | None = None

    @property
    def busy(self) -> bool:
        """Whether a transition is under way."""
        return self._running is not None

    def check(self, event: Event) -> State:
        """Where ``event`` leads from here.

        Raises:
            StateError: The table does not allow it, or another transition is under way.
        """
        target = next_state(self.state, event)
        if self._running is not None and event is not Event.ESTOP:
            raise StateError(
                f"{event.value} is refused while {self._running.event.value} is under way; wait for it, or estop",
                state=self.state.value,
                request=event.value,
            )
        return target

    def reserve(self, group: str) -> None:
        """Give a group its slots.

        Raises:
            StateError: Not allowed now, a slot is owned by another group, or does not answer.
            NotFoundError: There is no such group.
        """
        target = self.check(Event.RESERVE)
        self.reservations.reserve(group)
        if not np.isfinite(self.measured.q[self._index[group]]).all():
            self.reservations.release(group)
            raise StateError(f"group '{group}' cannot be reserved: a slot of it gives no reading", group=group)
        self.state = target

    def release(self, group: str) -> None:
        """Take a group's slots back.

        Raises:
            StateError: Not allowed now, or the group is not reserved.
            NotFoundError: There is no such group.
        """
        self.check(Event.RELEASE)
        self.reservations.release(group)
        self.state = next_state(self.state, Event.RELEASE if self.reservations.groups else Event.RELEASE_LAST)

    def begin(self, event: Event, reply: Reply) -> None:
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
        if event is Event.RESET and (self.measured.power or not self.measured.brakes.all()):
            raise StateError("reset is refused: the testbed still reports power on or a brake off")
        steps = {
            Event.POWER_ON: self._power_on,
            Event.POWER_OFF: self._power_off,
            Event.ENABLE_MOTION: self._enable_motion,
            Event.DISABLE_MOTION: self._disable_motion,
            Event.RESET: self._reset,
        }[event]
        self._running = _Running(event, steps(target), reply)

    def tick(self) -> None:
        """Go on with the transition that is under way."""
        running = self._running
        if running is None:
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

        Args:
            reason: Why.
            **facts: Named values the reason speaks of.

        Raises:
            StateError: There is nothing to stop: power is off already.
        """
        target = self.check(Event.ESTOP)
        error = StateError(f"emergency stop: {reason}", reason=reason)
        error.facts.update(facts)
        running, self._running = self._running, None
        self.state = target
        self.cause = reason
        self.power = False
        self.brakes = np.ones_like(self.brakes)
        self._arms.drop(error)
        if running is not None:
            running.steps.close()
            running.reply(error)

    def reserved_joints(self) -> NDArray[np.intp]:
        """Ranks of all joints of reserved groups."""
        return np.concatenate([self._index[group] for group in self.reservations.groups])

    def _power_on(self, target: State) -> Generator[None, None, None]:
        self.power = True
        try:
            yield from self._until(lambda: self.measured.power, "the testbed to switch power on")
        except WaitTimeoutError:
            self.power = False
            raise
        self.state = target

    def _power_off(self, target: State) -> Generator[None, None, None]:
        self.power = False
        yield from self._until(lambda: not self.measured.power, "the testbed to switch power off")
        self.state = target

    def _enable_motion(self, target: State) -> Generator[None, None, None]:
        joints = self.reserved_joints()
        self._arms.engage(self.reservations.groups)
        yield from self._ticks(self._settings.brake_lead_ticks)  # torque carries the arm before the brakes let go
        self.brakes[joints] = False
        try:
            yield from self._until(lambda: not self.measured.brakes[joints].any(), "the brakes to release")
        except WaitTimeoutError:
            self.brakes[joints] = True
            self._arms.disengage()
            raise
        self.state = target
        while not self._arms.settled():
            yield

    def _disable_motion(self, target: State) -> Generator[None, None, None]:
        joints = self.reserved_joints()
        self.brakes[joints] = True
        yield from self._until(lambda: bool(self.measured.brakes[joints].all()), "the brakes to engage")
        yield from self._ticks(self._settings.brake_lead_ticks)  # brakes hold before the torque leaves
        self._arms.disengage()
        self.state = target

    def _reset(self, target: State) -> Generator[None, None, None]:
        self.reservations.release_all()
        self.cause = ""
        self.state = target
        yield from ()

    def _ticks(self, count: int) -> Generator[None, None, None]:
        for _ in range(count):
            yield

    def _until(self, holds: Callable[[], bool], what: str) -> Generator[None, None, None]:
        timeout_s = self._settings.answer_timeout_s
        for _ in range(round(timeout_s / self._settings.period_s)):
            if holds():
                return
            yield
        raise WaitTimeoutError(what=what, seconds=timeout_s)
