"""Deceleration to rest from any motion, jerk-limited."""

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Synchronization
from ruckig import Trajectory as RuckigTrajectory

from im_core.errors import DataError
from im_mcs.planning.joint_path import MotionLimits
from im_mcs.planning.setpoint import Setpoint


class StopTrajectory:
    """Brings the joints to rest as fast as acceleration and jerk limits allow, all at the same time.

    Args:
        start: Present setpoint.
        limits: Limits of acceleration and jerk.

    Raises:
        DataError: Ruckig finds no trajectory.
    """

    def __init__(self, start: Setpoint, limits: MotionLimits) -> None:
        n = len(start.q)
        request = InputParameter(n)
        request.control_interface = ControlInterface.Velocity
        request.synchronization = Synchronization.Phase
        request.current_position = start.q.tolist()
        request.current_velocity = start.v.tolist()
        # the setpoint's acceleration may exceed the limit by rounding only
        request.current_acceleration = np.clip(start.a, -limits.acceleration, limits.acceleration).tolist()
        request.target_velocity = [0.0] * n
        request.max_acceleration = limits.acceleration.tolist()
        request.max_jerk = limits.jerk.tolist()
        self._trajectory = RuckigTrajectory(n)
        result = Ruckig(n).calculate(request, self._trajectory)
        if result not in (Result.Working, Result.Finished):
            raise DataError(f"no deceleration from {start.v.tolist()}: ruckig reports {result.name}")
        self.duration: float = self._trajectory.duration
        self._end: NDArray[np.float64] = np.array(self._trajectory.at_time(self.duration)[0])

    def at(self, t: float) -> Setpoint:
        """Setpoint at time ``t`` [s] after the start."""
        if t >= self.duration:
            return Setpoint.at_rest(self._end)
        q, v, a = self._trajectory.at_time(t)
        return Setpoint(np.array(q), np.array(v), np.array(a))

    def point(self, t: float) -> int:
        """Always 0: the only point is where the motion ends."""
        return 0
