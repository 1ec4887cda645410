"""What a watch sees, and what it may ask for."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.servo.group import ControlledGroup
from im_mcs.testbed.driver import Measured


class Reaction(Enum):
    """What a finding leads to."""

    END = "end"
    """Decelerate on the path and hold; the goals end with the fault."""
    PROTECTIVE_STOP = "protective stop"
    """Decelerate on the path and hold; the goals are suspended until ``resume``."""
    ESTOP = "emergency stop"
    """In the same tick: no setpoint, no torque, brakes on, power off."""


@dataclass(frozen=True)
class Finding:
    """What a watch has found.

    Attributes:
        reaction: What to do.
        fault: Why.
        groups: Which groups it concerns; None: all.
    """

    reaction: Reaction
    fault: ImError
    groups: tuple[str, ...] | None = None


@dataclass
class Situation:
    """A tick in the eyes of the watches; filled anew in every tick.

    Attributes:
        measured: What the slots say.
        v: Estimated velocities, shape (n,) [rad/s or m/s].
        power: Whether power is commanded.
        brakes: Which brakes are commanded to hold, shape (n,).
        groups: Groups of the preset in force.
        owner_silence_s: For how long the owner process has given no sign of life, wall time [s].
        overruns: Servo deadlines missed in a row.
    """

    measured: Measured
    v: NDArray[np.float64]
    groups: Mapping[str, ControlledGroup]
    brakes: NDArray[np.bool_]
    power: bool = False
    owner_silence_s: float = 0.0
    overruns: int = 0


class Watch(Protocol):
    """Looks at one thing that may go wrong, in every tick with power on."""

    def check(self, now: Situation) -> Finding | None:
        """What is wrong, if anything."""
        ...
