"""One point with a possibly late arrival: a setpoint of a stream, or a target for now.

Whoever streams (``moveit_servo``, a joystick) sends one point at a time, some moments ahead and with a velocity, and
each takes the place of the one before. A point whose time cannot be kept is no reason to refuse it then: it moves on
with its velocity, and is met as soon as limits allow.

In order of preference, the first that keeps the limits: the quintic that meets the point at its time; quintics that
meet it later, which are gentler; the quickest motion that meets it (ruckig). When the time of a point with a velocity
is over, met or not, the motion decelerates to rest, unless another point has come by then.
"""

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.checks.context import PlanContext, Start
from im_mcs.planning.checks.envelope import check_range, slowdown
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, quintic
from im_mcs.planning.trajectories.profile import to_meet, with_run_out
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory
from im_mcs.protocol.requests import TrajectoryMove

_LATER = (1.0, 2.0, 4.0)
_MEETINGS = 5
# share of the jerk that is used, so that the motion can be slowed down on its path
_JERK = 0.6


class MeetingPreparation:
    """Prepares a motion to one point.

    Args:
        context: What it is planned with.
        move: The point.
        start: Gives the state it begins with.
    """

    def __init__(self, context: PlanContext, move: TrajectoryMove, start: Start) -> None:
        self._context, self._start = context, start
        points = move.points
        self._time, self._q = float(points.times[0]), points.q[0]
        self._v = np.zeros_like(self._q) if points.v is None else points.v[0]
        motion = context.limits.motion.of(context.index)
        self._limits = MotionLimits(motion.velocity, motion.acceleration, motion.jerk * _JERK)

    def step(self) -> Trajectory | None:
        """Do the whole work.

        Raises:
            LimitError: It would leave the range of a joint, or come to rest beyond it.
            DataError: Ruckig finds no trajectory.
        """
        start = self._start()
        motion = self._in_time(start) or self._quickest(start)
        if self._v.any() and self._time > 0.0:
            motion = motion.until(self._time)
        whole = with_run_out(motion, self._limits)
        check_range(self._context, whole)
        return whole

    def _at(self, time: float) -> NDArray[np.float64]:
        """Where the point is by then."""
        return np.asarray(self._q + self._v * (time - self._time))

    def _in_time(self, start: Setpoint) -> PiecewisePolynomial | None:
        for factor in _LATER if self._time > 0.0 else ():
            h = np.array([self._time * factor])
            q, v = np.vstack([start.q, self._at(float(h[0]))]), np.vstack([start.v, self._v])
            motion = PiecewisePolynomial(h.tolist(), quintic(h, q, v, np.vstack([start.a, np.zeros_like(start.a)])))
            if slowdown(motion, self._limits, slice(None)) <= 1.0:
                return motion
        return None

    def _quickest(self, start: Setpoint) -> PiecewisePolynomial:
        """Return the quickest motion, but not before the time; the point moves on meanwhile."""
        time = self._time
        for _ in range(_MEETINGS):
            motion = to_meet(start, self._at(time), self._v, self._limits, time)
            if motion.duration <= time or not self._v.any():
                break
            time = motion.duration
        return motion
