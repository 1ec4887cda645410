"""The testbed with every failure of a driver made a link error: drivers are the users', and may raise anything."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from im_core.errors import ImError, LinkError
from im_mcs.testbed import Drive, Measured, PlannedCourse, TestbedInterface

Given = ParamSpec("Given")
ResultT = TypeVar("ResultT")


class GuardedTestbed:
    """Testbed with no other exception than :class:`~im_core.errors.LinkError`.

    Attributes:
        period_s: Time between ticks [s].
        wall_period_s: Wall time between ticks that the loop shall keep [s]; 0 if the clock sets the pace.
        several: Whether there are several drivers, of which some may listen when another has failed.
    """

    def __init__(self, testbed: TestbedInterface) -> None:
        self._testbed = testbed
        self.period_s = testbed.period_s
        self.wall_period_s = testbed.wall_period_s
        self.several = testbed.several

    def connect(self) -> None:
        """Reach all hardware.

        Raises:
            LinkError: Some does not answer.
        """
        _guard("connect", self._testbed.connect)
        self.wall_period_s = self._testbed.wall_period_s

    def wait(self, timeout_s: float) -> bool:
        """Wait for the next tick, at most ``timeout_s`` of wall time [s]; return whether the tick came.

        Raises:
            LinkError: The hardware is gone.
        """
        return _guard("wait", self._testbed.wait, timeout_s)

    def time_asked(self) -> bool:
        """Return whether a tick must come: time passes without requests, or on request.

        Raises:
            LinkError: It does not say.
        """
        return _guard("time_asked", self._testbed.time_asked)

    @property
    def hardware_pid(self) -> int:
        """Process of the local host with the ticks; 0 where there is none."""
        return self._testbed.hardware_pid

    def read(self) -> Measured:
        """The newest measured state.

        Raises:
            LinkError: It cannot be read.
        """
        return _guard("read", self._testbed.read)

    def write(self, drive: Drive) -> None:
        """Answer the tick.

        Raises:
            LinkError: Some hardware no longer listens; all other has heard it.
        """
        _guard("write", self._testbed.write, drive)

    def speed(self) -> float:
        """Share of the wanted speed with which robots follow courses.

        Raises:
            LinkError: It is not told.
        """
        return _guard("speed", self._testbed.speed)

    def follow(self, course: PlannedCourse) -> None:
        """Give a course to the drivers that follow one.

        Raises:
            LinkError: Some hardware no longer listens.
        """
        _guard("follow", self._testbed.follow, course)

    def faults(self) -> list[str]:
        """Return the faults reported by hardware.

        Raises:
            LinkError: Some does not answer.
        """
        return _guard("faults", self._testbed.faults)

    def after_tick(self, tick: int) -> None:
        """Return once the hardware has taken the answer to ``tick``, where known.

        Raises:
            LinkError: A driver failed.
        """
        _guard("after_tick", self._testbed.after_tick, tick)

    def close(self) -> None:
        """Leave all hardware with power off and brakes on.

        Raises:
            LinkError: A driver failed.
        """
        _guard("close", self._testbed.close)


def _guard(method: str, call: Callable[Given, ResultT], *given: Given.args, **named: Given.kwargs) -> ResultT:
    try:
        return call(*given, **named)
    except LinkError:
        raise
    except Exception as error:
        told = error.message if isinstance(error, ImError) else f"{type(error).__name__}: {error}"
        fault = LinkError(f"the channel driver failed: {method}: {told}")
        raise fault from error
