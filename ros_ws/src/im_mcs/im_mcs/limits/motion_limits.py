"""Limits of every trajectory."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray


class Synchrony(StrEnum):
    """How the joints of a segment keep step; all arrive at the same time."""

    PHASE = "phase"
    """Straight line in joint space: every joint has covered the same fraction of its way."""
    TIME = "time"
    """Each joint on its own profile of the common duration."""


class BeyondLimits(StrEnum):
    """Rule for a trajectory with a velocity, acceleration or jerk beyond a limit."""

    RETIME = "retime"
    """It is followed on its own path, later than asked for."""
    REFUSE = "refuse"
    """Nothing moves."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a trajectory, each of shape (n,).

    Attributes:
        velocity: [rad/s or m/s].
        acceleration: [rad/s2 or m/s2].
        jerk: [rad/s3 or m/s3].
    """

    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    jerk: NDArray[np.float64]

    def of(self, index: NDArray[np.intp]) -> Self:
        """Return the limits of the joints ``index``."""
        return type(self)(self.velocity[index], self.acceleration[index], self.jerk[index])

    def along(self, way: NDArray[np.float64]) -> tuple[float, float, float]:
        """Return speed, acceleration and jerk limits of the fraction of a straight ``way``, shape (n,), not zero."""
        used = np.abs(way)
        with np.errstate(divide="ignore", over="ignore"):
            return (
                float((self.velocity / used).min()),
                float((self.acceleration / used).min()),
                float((self.jerk / used).min()),
            )
