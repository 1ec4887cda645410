"""Common part of all ends of the testbed link, and the end for clients of testbed time only."""

from enum import IntEnum
from types import TracebackType
from typing import ClassVar, Self

from im_cell.link.block import LinkBlock
from im_core import clock
from im_core.errors import LinkError, WaitTimeoutError

_POLL_S = 0.0005


class LinkEnd:
    """End of the testbed link, with tick period, present tick, and presence of the testbed.

    Attributes:
        instance: Name of the machine.
        n_joints, n_grippers, n_wrenches: Numbers of joints, grippers and wrist sensors.
        factor: Clock factor; 0: as fast as it goes.
        seed: Of the testbed's random numbers.
        period_ns: Time of a tick [ns].
        period_s: The same [s].
        light_names: Of the lights, in the order of their numbers.
    """

    def __init__(self, shared: LinkBlock) -> None:
        """Use :meth:`attach`."""
        self._shared = shared
        self.instance = shared.instance
        self.n_joints, self.n_grippers, self.n_wrenches = shared.n_joints, shared.n_grippers, shared.n_wrenches
        self.factor = shared.factor
        self.seed = shared.seed
        self.period_ns = shared.period_ns
        self.period_s = shared.period_ns * 1e-9
        self.light_names = shared.light_names

    @classmethod
    def attach(cls, instance: str, timeout_s: float) -> Self:
        """Attach to the link of an instance.

        Raises:
            LinkError: There is none with a living physics process within ``timeout_s`` [s].
        """
        return cls(LinkBlock.attach(instance, timeout_s))

    @property
    def tick(self) -> int:
        """Number of ticks since the start."""
        return int(self._shared.view["tick"])

    @property
    def wall_period_s(self) -> float:
        """Wall time between ticks [s]; 0 at clock factor 0, as fast as possible."""
        return self.period_s / self.factor if self.factor > 0.0 else 0.0

    def time_asked(self) -> bool:
        """Whether somebody has asked for time beyond the present tick."""
        until: int = max(self._shared.view["demand_until"].tolist())
        return until > self.tick

    @property
    def physics_pid(self) -> int:
        """The physics process."""
        return self._shared.block.owner_pid

    def physics_alive(self) -> bool:
        """Whether the physics process runs."""
        return self._shared.block.owner_alive()

    def close(self) -> None:
        """Release the link; the creator also removes the names of the link."""
        self._shared.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class TimeSlot(IntEnum):
    """Slots for time requests at clock factor 0; one process each."""

    MCS = 0
    TESTBED = 1
    VSS = 2


class ClockEnd(LinkEnd):
    """End of the link for clock requests and waits, for a client of MCS; other ends use separate slots."""

    slot: ClassVar[TimeSlot] = TimeSlot.MCS

    def request_time(self, ticks: int) -> int:
        """Ask, at clock factor 0, for ``ticks`` more ticks from now.

        Returns:
            The tick up to which time now passes, for :meth:`wait_tick`.
        """
        return self.request_until(self.tick + ticks)

    def request_until(self, tick: int) -> int:
        """Ask, at clock factor 0, for time up to a tick; asking again for the same tick changes nothing.

        Returns:
            The tick up to which time now passes, for :meth:`wait_tick`.
        """
        demand = self._shared.view["demand_until"]
        until = max(int(demand[self.slot]), tick)
        demand[self.slot] = until
        self._shared.wake.post()
        return until

    def wait_tick(self, tick: int, timeout_s: float) -> int:
        """Wait until the testbed has reached a tick, and return the present tick.

        Raises:
            LinkError: Physics is gone.
            WaitTimeoutError: The tick was not reached within ``timeout_s`` of wall time [s].
        """
        deadline = clock.monotonic() + timeout_s
        next_check = clock.monotonic() + 0.1
        while (now := self.tick) < tick:
            wall = clock.monotonic()
            if wall > deadline:
                raise WaitTimeoutError(what=f"tick {tick} of the testbed (it is at {now})", seconds=timeout_s)
            if wall > next_check:
                next_check = wall + 0.1
                if not self.physics_alive():
                    raise LinkError("the testbed's physics process is gone")
            clock.sleep(_POLL_S)
        return now


class StopEnd(ClockEnd):
    """Emergency stop circuit: a switch of the motor power independent of the servo.

    While it is cut, motors have no power and brakes are on, whatever the servo commands; it stays cut until it is
    restored, whoever is gone meanwhile. A servo that does not answer then is waited for a tenth as long as else.
    """

    def cut(self) -> None:
        """Cut the motor power at the next tick; at clock factor 0, request the tick, too."""
        self._shared.view["stop"][()] = True
        self.request_time(1)

    def restore(self) -> None:
        """Let the servo switch power on again."""
        self._shared.view["stop"][()] = False

    @property
    def is_cut(self) -> bool:
        """Whether there can be no power."""
        return bool(self._shared.view["stop"])

    def reading(self) -> tuple[bool, bool]:
        """Read whether the motors have power, and whether every brake is engaged, in the newest tick."""
        view = self._shared.view
        return bool(view["power"]), bool(view["brakes"].all())
