"""Setpoints of one group: trajectory at a multiple of the servo period, interpolated at servo rate."""

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.joint_path import MotionLimits
from im_mcs.planning.setpoint import Setpoint
from im_mcs.planning.stop import StopTrajectory
from im_mcs.planning.trajectory import Hold, Trajectory


class GroupPlanner:
    """Follows one trajectory after the other; between them it holds.

    The trajectory is evaluated every ``divisor`` ticks (the paper: "typically calculated at a frequency that is a
    multiple of the servo frequency"); in between, setpoints are the cubic through both neighbours.

    Args:
        q: Where the group is, shape (n,) [rad or m]; the first setpoint.
        period_s: Servo period [s].
        divisor: Servo ticks between two evaluations, >= 1.
        limits: Limits of the group, for decelerations.
    """

    def __init__(self, q: NDArray[np.float64], period_s: float, divisor: int, limits: MotionLimits) -> None:
        self._period = period_s
        self._divisor = divisor
        self._limits = limits
        self._trajectory: Trajectory = Hold(q)
        self._tick = 0
        self._ended = False
        self._knots: tuple[Setpoint, Setpoint] | None = None
        self.setpoint = Setpoint.at_rest(q)

    def hold(self, q: NDArray[np.float64]) -> None:
        """Stand still at ``q`` from now on, whatever was before."""
        self._follow(Hold(q))
        self.setpoint = Setpoint.at_rest(q)

    def follow(self, trajectory: Trajectory) -> None:
        """Follow ``trajectory`` from the next tick on; it must begin at the present setpoint."""
        self._follow(trajectory)

    def stop(self) -> None:
        """Decelerate from the present setpoint to rest."""
        self._follow(StopTrajectory(self.setpoint, self._limits))

    @property
    def finished(self) -> bool:
        """Whether the trajectory has come to its end; a group that holds has."""
        return self._tick * self._period >= self._trajectory.duration

    @property
    def elapsed(self) -> float:
        """Time on the present trajectory [s]."""
        return self._tick * self._period

    @property
    def progress(self) -> float:
        """Fraction of the trajectory's time that has passed, 0 to 1."""
        if self._trajectory.duration == 0.0:
            return 1.0
        return min(self.elapsed / self._trajectory.duration, 1.0)

    @property
    def point(self) -> int:
        """Point of the path that the group is on its way to."""
        return self._trajectory.point(self.elapsed)

    def advance(self) -> Setpoint:
        """The setpoint of the next servo tick."""
        if self.finished:
            if not self._ended:
                self._ended = True
                self.setpoint = self._trajectory.at(self._trajectory.duration)
            return self.setpoint
        self._tick += 1
        t = self._tick * self._period
        if self._divisor == 1 or t >= self._trajectory.duration:
            self.setpoint = self._trajectory.at(t)
            return self.setpoint
        phase = self._tick % self._divisor
        if phase == 1 or self._knots is None:
            start = (self._tick - phase) * self._period
            self._knots = (self._trajectory.at(start), self._trajectory.at(start + self._divisor * self._period))
        a, b = self._knots
        self.setpoint = b if phase == 0 else self._between(a, b, phase / self._divisor)
        return self.setpoint

    def _follow(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self._tick = 0
        self._ended = False
        self._knots = None

    def _between(self, a: Setpoint, b: Setpoint, s: float) -> Setpoint:
        """Cubic Hermite between knots at fraction ``s``."""
        h = self._divisor * self._period
        step = b.q - a.q
        # p(s) = a.q + c1 s + c2 s^2 + c3 s^3
        c1 = h * a.v
        c2 = 3.0 * step - h * (2.0 * a.v + b.v)
        c3 = h * (a.v + b.v) - 2.0 * step
        q = a.q + s * (c1 + s * (c2 + s * c3))
        v = (c1 + s * (2.0 * c2 + 3.0 * s * c3)) / h
        return Setpoint(q, v, a.a + s * (b.a - a.a))
