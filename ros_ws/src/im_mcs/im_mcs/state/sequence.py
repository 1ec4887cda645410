"""What a transition does over several ticks; each is a generator that yields once a tick."""

from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, WaitTimeoutError
from im_mcs.config import Servo
from im_mcs.state.brakes import named
from im_mcs.state.table import State

if TYPE_CHECKING:
    from im_mcs.state.manager import StateManager


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


class Sequences:
    """Orders power, brakes and torque.

    Args:
        manager: Whose state, power and brakes they change.
        arms: The layers above the slots.
        settings: Times.
    """

    def __init__(self, manager: "StateManager", arms: Arms, settings: Servo) -> None:
        self._manager = manager
        self._arms = arms
        self._settings = settings

    def power_on(self, target: State) -> Generator[None, None, None]:
        """Power on, brakes on."""
        self._manager.power = True
        try:
            yield from self._until(lambda: self._manager.measured.power, lambda: "the testbed to switch power on")
        except WaitTimeoutError:
            self._manager.power = False
            raise
        self._manager.state = target

    def power_off(self, target: State) -> Generator[None, None, None]:
        """Power off; if it stays on, an e-stop."""
        self._manager.power = False
        try:
            yield from self._until(lambda: not self._manager.measured.power, lambda: "the testbed to switch power off")
        except WaitTimeoutError as error:
            self._manager.fail(f"power is not obeyed: {error.message}")
            raise
        self._manager.state = target

    def enable_motion(self, target: State) -> Generator[None, None, None]:
        """Torque carries the arm before the brakes let go; then until all is at rest."""
        joints = self._manager.reserved_joints()
        self._arms.engage(self._manager.reservations.groups)
        yield from self._ticks(self._settings.brake_lead_ticks)
        self._manager.brakes[joints] = False
        try:
            yield from self._until_moved(joints, engaged=False)
        except WaitTimeoutError as error:
            self._manager.brakes[joints] = True
            yield from self._until_braked(joints, error)
            self._arms.disengage()
            raise
        self._manager.state = target
        while not self._arms.settled():
            yield

    def disable_motion(self, target: State) -> Generator[None, None, None]:
        """Brakes hold before the torque leaves; if they do not, it goes on carrying the arm."""
        joints = self._manager.reserved_joints()
        self._manager.brakes[joints] = True
        try:
            yield from self._until_braked(joints)
        except WaitTimeoutError:
            self._manager.brakes[joints] = False
            raise
        self._arms.disengage()
        self._manager.state = target

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
                self._manager.fail(f"brakes are not obeyed: {cause.message}; {error.message}")
            raise
        yield from self._ticks(self._settings.brake_lead_ticks)

    def reset(self, target: State) -> Generator[None, None, None]:
        """Forget reservations and cause; nothing moves."""
        self._manager.reservations.release_all()
        self._manager.cause = ""
        self._manager.state = target
        yield from ()

    def _ticks(self, count: int) -> Generator[None, None, None]:
        for _ in range(count):
            yield

    def _until_moved(self, joints: NDArray[np.intp], engaged: bool) -> Generator[None, None, None]:
        """Until the brakes of ``joints`` report to be as they are told; else the error names those that do not."""

        def not_yet() -> NDArray[np.intp]:
            moved: NDArray[np.bool_] = self._manager.measured.brakes[joints] == engaged
            return joints[~moved]

        verb = "engage" if engaged else "release"
        yield from self._until(
            lambda: not not_yet().size,
            lambda: f"the brakes to {verb}, those of {named(self._manager.joints, not_yet())}",
        )

    def _until(self, holds: Callable[[], bool], what: Callable[[], str]) -> Generator[None, None, None]:
        timeout_s = self._settings.answer_timeout_s
        for _ in range(round(timeout_s / self._settings.period_s)):
            if holds():
                return
            yield
        raise WaitTimeoutError(what=what(), seconds=timeout_s)
