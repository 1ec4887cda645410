"""The testbed link: one object for all its users."""

from types import TracebackType
from typing import Self

from im_core import clock
from im_core.errors import DataError, LinkError, WaitTimeoutError
from im_core.testbed_link.block import MAX_LIGHTS, LinkBlock
from im_core.testbed_link.camera import CameraSide
from im_core.testbed_link.disturb import DisturbSide
from im_core.testbed_link.host import HostSide
from im_core.testbed_link.laser import LaserSide
from im_core.testbed_link.servo import ServoSide
from im_core.testbed_link.values import Slot, TrueState

DEFAULT_LIGHTS = ("left_led", "right_led")
_POLL_S = 0.0005


class TestbedLink(HostSide, ServoSide, CameraSide, LaserSide, DisturbSide):
    """Shared memory and semaphores between physics, servo and cameras; see the package's docstring."""

    __test__ = False  # not a test class, whatever pytest thinks of the name

    def __init__(self, shared: LinkBlock) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self._shared = shared
        self.instance = shared.instance
        self.n_joints = shared.n_joints
        self.factor = shared.factor
        self.seed = shared.seed
        self.period_ns = shared.period_ns
        self.period_s = shared.period_ns * 1e-9
        self.light_names = shared.light_names

    @classmethod
    def create(
        cls,
        instance: str,
        n_joints: int = 18,
        period_s: float = 0.0045,
        factor: float = 1.0,
        seed: int = 0,
        light_names: tuple[str, ...] = DEFAULT_LIGHTS,
    ) -> Self:
        """Create the link, as the physics process; what a dead machine left behind is replaced.

        Others can attach once the first state is published.

        Raises:
            DataError: Period, factor or number of lights is out of range.
            LinkError: A living process of the same instance owns the link.
        """
        if period_s <= 0.0:
            raise DataError(f"testbed period {period_s} s is not > 0", period=period_s)
        if factor < 0.0:
            raise DataError(f"clock factor {factor} is not >= 0", factor=factor)
        if len(light_names) > MAX_LIGHTS:
            raise DataError(f"{len(light_names)} lights are more than {MAX_LIGHTS}", lights=len(light_names))
        return cls(LinkBlock.create(instance, n_joints, round(period_s * 1e9), factor, seed, light_names))

    @classmethod
    def attach(cls, instance: str, timeout_s: float) -> Self:
        """Attach to the link of an instance.

        Raises:
            LinkError: There is none with a living physics process within ``timeout_s`` [s].
        """
        return cls(LinkBlock.attach(instance, timeout_s))

    @property
    def tick(self) -> int:
        """Ticks since the start."""
        return int(self._shared.view["tick"])

    @property
    def stamp_ns(self) -> int:
        """Testbed time [ns]."""
        return self.tick * self.period_ns

    @property
    def wall_period_s(self) -> float:
        """Wall time between ticks [s]; 0 at clock factor 0, as fast as it goes."""
        return self.period_s / self.factor if self.factor > 0.0 else 0.0

    def physics_alive(self) -> bool:
        """Whether the physics process runs."""
        return self._shared.block.owner_alive()

    def request_time(self, slot: Slot | int, ticks: int) -> int:
        """Ask, at clock factor 0, for ``ticks`` more ticks.

        Args:
            slot: Who asks; one process a slot.
            ticks: Ticks from now.

        Returns:
            The tick up to which time now passes, for :meth:`wait_tick`.
        """
        return self.request_until(slot, self.tick + ticks)

    def request_until(self, slot: Slot | int, tick: int) -> int:
        """Ask, at clock factor 0, for time up to a tick; asking again for the same tick changes nothing.

        Args:
            slot: Who asks; one process a slot.
            tick: Tick that is to be reached.

        Returns:
            The tick up to which time now passes, for :meth:`wait_tick`.
        """
        view = self._shared.view
        until = max(int(view["demand_until"][slot]), tick)
        view["demand_until"][slot] = until
        self._shared.wake.post()
        return until

    def wait_tick(self, tick: int, timeout_s: float) -> int:
        """Wait until the testbed has reached a tick, and return the one it is at.

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

    def set_light(self, index: int, on: bool) -> None:
        """Switch a light; it is seen from the next tick on.

        Raises:
            DataError: There is no light of that index.
        """
        if not 0 <= index < len(self.light_names):
            raise DataError(f"light {index} is not one of 0 to {len(self.light_names) - 1}", index=index)
        self._shared.view["lights"][index] = on

    def lights(self) -> tuple[bool, ...]:
        """Which lights are switched on, in the order of ``light_names``."""
        return tuple(bool(on) for on in self._shared.view["lights"][: len(self.light_names)])

    def read_truth(self) -> TrueState:
        """True joint state; for the testbed's own node and for tests, nobody else."""
        view = self._shared.view
        return TrueState(
            q=view["q_true"].copy(),
            v=view["v_true"].copy(),
            servo_losses=int(view["servo_losses"]),
            servo_pid=int(view["servo_pid"]),
        )

    def close(self) -> None:
        """Release the link; the creator also removes its names."""
        self._shared.close()

    def unlink(self) -> None:
        """Remove the link's names, as its creator; whoever is attached keeps the memory."""
        self._shared.unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
