"""Joint-interpolated motion through points (paper, section 4), jerk-limited and time-optimal for each segment."""

import bisect
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate, pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray
from ruckig import InputParameter, Result, Ruckig, RuckigError, Synchronization
from ruckig import Trajectory as RuckigTrajectory

from im_core.errors import DataError
from im_mcs.planning.setpoint import Setpoint


class Synchrony(StrEnum):
    """How the joints of a segment keep step; all arrive at the same time."""

    PHASE = "phase"
    """Straight line in joint space: every joint has covered the same fraction of its way."""
    TIME = "time"
    """Each joint on its own profile of the common duration."""


_RUCKIG = {Synchrony.PHASE: Synchronization.Phase, Synchrony.TIME: Synchronization.Time}


@dataclass(frozen=True)
class MotionLimits:
    """Limits that a trajectory keeps, each of shape (n,).

    Attributes:
        velocity: [rad/s or m/s].
        acceleration: [rad/s2 or m/s2].
        jerk: [rad/s3 or m/s3].
    """

    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    jerk: NDArray[np.float64]

    def scaled(self, scale: float) -> Self:
        """All three multiplied by ``scale``."""
        return type(self)(self.velocity * scale, self.acceleration * scale, self.jerk * scale)

    def of(self, index: NDArray[np.intp]) -> Self:
        """Those of the joints ``index``."""
        return type(self)(self.velocity[index], self.acceleration[index], self.jerk[index])


class JointPath:
    """Consecutive joint-interpolated segments; at rest in every point.

    Ruckig's own intermediate waypoints are not used: they need a service in the network.

    Args:
        start: Where the motion begins, at rest, shape (n,) [rad or m].
        points: Points to pass, shape (m, n), m > 0.
        limits: Limits of velocity, acceleration and jerk.
        synchrony: How the joints keep step.

    Raises:
        DataError: Ruckig finds no trajectory.
    """

    def __init__(
        self,
        start: NDArray[np.float64],
        points: NDArray[np.float64],
        limits: MotionLimits,
        synchrony: Synchrony = Synchrony.PHASE,
    ) -> None:
        corners = [start, *points]
        self._end = Setpoint.at_rest(np.asarray(corners[-1], dtype=np.float64))
        self._segments = [_segment(a, b, limits, synchrony) for a, b in pairwise(corners)]
        self._starts = list(accumulate((s.duration for s in self._segments), initial=0.0))
        self.duration: float = self._starts.pop()

    def at(self, t: float) -> Setpoint:
        """Setpoint at time ``t`` [s] after the start."""
        if t >= self.duration:
            return self._end
        i = self.point(t)
        q, v, a = self._segments[i].at_time(t - self._starts[i])
        return Setpoint(np.array(q), np.array(v), np.array(a))

    def point(self, t: float) -> int:
        """Index of the point that the motion is on its way to."""
        return max(bisect.bisect_right(self._starts, t) - 1, 0)


def _segment(
    start: NDArray[np.float64], end: NDArray[np.float64], limits: MotionLimits, synchrony: Synchrony
) -> RuckigTrajectory:
    """Time-optimal jerk-limited motion from rest to rest."""
    n = len(start)
    request = InputParameter(n)
    request.current_position, request.target_position = start.tolist(), end.tolist()
    request.max_velocity = limits.velocity.tolist()
    request.max_acceleration = limits.acceleration.tolist()
    request.max_jerk = limits.jerk.tolist()
    request.synchronization = _RUCKIG[synchrony]
    trajectory = RuckigTrajectory(n)
    try:
        result = Ruckig(n).calculate(request, trajectory)
    except RuckigError as error:
        raise DataError(f"no trajectory from {start.tolist()} to {end.tolist()}: {error}") from None
    if result not in (Result.Working, Result.Finished):
        raise DataError(f"no trajectory from {start.tolist()} to {end.tolist()}: ruckig reports {result.name}")
    return trajectory
