"""Contract of a channel driver: what MCS needs of hardware, simulated or real."""

import importlib
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ConfigError


@dataclass(frozen=True)
class Measured:
    """What the channels say at the start of a tick.

    Attributes:
        tick: Number of the tick.
        stamp_ns: Testbed time [ns].
        q: Positions, shape (n,) [rad or m].
        power: Whether the motors have power.
        brakes: Which brakes are engaged, shape (n,).
        gripper: Openings, shape (m,) [m].
    """

    tick: int
    stamp_ns: int
    q: NDArray[np.float64]
    power: bool
    brakes: NDArray[np.bool_]
    gripper: NDArray[np.float64]


@dataclass(frozen=True)
class Drive:
    """What the channels shall do until the next tick.

    Attributes:
        tau: Torques, shape (n,) [Nm or N].
        power: Whether the motors shall have power.
        brakes: Which brakes shall be engaged, shape (n,).
        gripper: Wanted openings, shape (m,) [m].
        wants_time: Whether MCS waits for something, so that simulated time must go on.
    """

    tau: NDArray[np.float64]
    power: bool
    brakes: NDArray[np.bool_]
    gripper: NDArray[np.float64]
    wants_time: bool


class ChannelDriver(Protocol):
    """Hardware seen as numbered channels.

    The loop calls ``connect`` once, then in every tick ``wait``, ``read``, ``write``, in the end ``close``.
    """

    n_joints: int
    n_grippers: int
    period_s: float
    """Time between ticks [s]."""
    wall_period_s: float
    """Wall time between ticks that the loop shall keep [s]; 0 if the driver sets the pace."""

    def connect(self) -> None:
        """Reach the hardware; afterwards :meth:`read` works.

        Raises:
            LinkError: It does not answer.
        """
        ...

    def wait(self, timeout_s: float) -> bool:
        """Wait for the next tick, at most ``timeout_s`` of wall time [s]; whether it came.

        Raises:
            LinkError: The hardware is gone.
        """
        ...

    def read(self) -> Measured:
        """The newest measured state."""
        ...

    def write(self, drive: Drive) -> None:
        """Answer the tick.

        Raises:
            LinkError: The hardware no longer listens to this driver.
        """
        ...

    def after_tick(self, tick: int) -> None:
        """Return once the hardware has taken the answer to ``tick``, where that can be known."""
        ...

    def close(self) -> None:
        """Leave the hardware with power off and brakes on."""
        ...


def load_driver(name: str, **settings: object) -> ChannelDriver:
    """Make the driver that the configuration names ``module:Class``.

    Raises:
        ConfigError: There is no such module or class.
    """
    module_name, _, class_name = name.partition(":")
    try:
        factory = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"channel driver '{name}' cannot be loaded: {error}; it is written module:Class") from None
    return cast(ChannelDriver, factory(**settings))
