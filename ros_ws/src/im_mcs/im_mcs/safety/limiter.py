"""Limits of position, velocity, acceleration and jerk of every setpoint, from any source."""

import numpy as np
from numpy.typing import NDArray
from ruckig import InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from im_core.errors import DataError, ImError
from im_mcs.limits.braking import flags_within
from im_mcs.limits.limits import JointLimits
from im_mcs.limits.saturation import Saturations
from im_mcs.safety.stopping_position import Reach

_ROUNDING = 1e-6


class SetpointLimiter:
    """Limiter of setpoints: passes possible ones, and approaches the others as fast as allowed.

    A setpoint passes unchanged if velocity and acceleration are within their limits, if it goes on where the last one
    was within the limit of jerk, and if braking from it does not leave the joint's range. Else the joint goes to it by
    a jerk-limited motion of its own, which ends within the range, until setpoints can be followed again. A joint that
    is out of its range, as after an e-stop at its end, may stay and come back but not go further out.

    Attributes:
        cut: Joints whose setpoints were not let through in the last tick, shape (n,).

    Args:
        limits: Limits of all joints.
        period_s: Servo period [s].
        plan_s: Period at which trajectories are evaluated [s]; between, setpoints are interpolated.
        jerk_factor: Tolerated jerk of setpoints, as a multiple of its limit.
        saturations: Counts what is cut.
    """

    def __init__(
        self, limits: JointLimits, period_s: float, plan_s: float, jerk_factor: float, saturations: Saturations
    ) -> None:
        n = len(limits.names)
        self._names = limits.names
        self._limits = limits
        self._motion = limits.ceiling
        self._saturations = saturations
        self._period = period_s
        self._last = np.zeros((3, n))
        self._ends = np.array([limits.lower - _ROUNDING, limits.upper + _ROUNDING])
        self._hardest = np.array([limits.ceiling.acceleration, limits.ceiling.jerk])
        jerk = limits.ceiling.jerk * jerk_factor
        self._largest = np.array([limits.ceiling.velocity, limits.ceiling.acceleration]) * (1.0 + _ROUNDING)
        self._leap = np.array([jerk * plan_s**3, jerk * plan_s**2, jerk * period_s]) + 1e-12
        self._slopes = Reach(limits.ceiling).slopes
        self._free = np.ones(n, dtype=np.bool_)
        self.cut = np.zeros(n, dtype=np.bool_)
        self._any_catching = False
        self._bounds = self._bounds_of_free()

    def hold(self, index: NDArray[np.intp], q: NDArray[np.float64]) -> None:
        """Joints ``index`` are under control from now on, at rest at ``q``, shape (k,)."""
        self.place(index, q)
        self._release(index, free=False)

    def place(self, index: NDArray[np.intp], q: NDArray[np.float64]) -> None:
        """Set the setpoints of joints ``index`` to rest at ``q``, shape (k,)."""
        self._last[:, index] = 0.0
        self._last[0, index] = q

    def release(self, index: NDArray[np.intp]) -> None:
        """Joints ``index`` have no setpoints any more."""
        self._release(index, free=True)

    def limit(self, wanted: NDArray[np.float64]) -> bool:
        """Limit the setpoints of a tick, in place; whether any was changed.

        Args:
            wanted: Positions, velocities, accelerations, shape (3, n); joints without control: anything finite.

        Raises:
            DataError: A setpoint is not finite; the joint is named.
        """
        within = flags_within(wanted, self._last, self._period, self._bounds, self._slopes, self._ends, self._hardest)
        changed = (within is not None or self._any_catching) and self._cut(wanted, within)
        self._last[:] = wanted
        return changed

    def _cut(self, wanted: NDArray[np.float64], within: NDArray[np.bool_] | None) -> bool:
        finite = np.isfinite(wanted).all(axis=0)
        if not finite.all():
            joint = self._names[int(np.argmin(finite))]
            raise DataError(f"{joint}: the setpoint {wanted[:, int(np.argmin(finite))].tolist()} is not finite")
        if within is None:
            within = np.ones(self._bounds.shape, dtype=np.bool_)
        leaps, given, beyond = within[:3], within[3:5], ~within[5]
        cut = beyond | ~leaps.all(axis=0) | ~given.all(axis=0)
        for kind, flags in (
            ("position", beyond),
            ("velocity", ~leaps[0] | ~given[0]),
            ("acceleration", ~leaps[1] | ~given[1]),
            ("jerk", ~leaps[2]),
        ):
            if flags.any():
                self._saturations.add(kind, flags)
        self.cut = cut
        self._any_catching = bool(cut.any())
        if self._any_catching:
            wanted[:, cut] = self._towards(wanted[0])[:, cut]
        return self._any_catching

    def _range(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        q = self._last[0]
        return np.minimum(self._ends[0], q), np.maximum(self._ends[1], q)

    def _towards(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Next step of the fastest motion to rest at ``q``, or at the end of the range, shape (3, n)."""
        n, motion, last = len(q), self._motion, self._last
        lower, upper = self._range()
        request = InputParameter(n)
        request.synchronization = Synchronization.No
        request.current_position = last[0].tolist()
        request.current_velocity = np.clip(last[1], -motion.velocity, motion.velocity).tolist()
        request.current_acceleration = np.clip(last[2], -motion.acceleration, motion.acceleration).tolist()
        request.target_position = np.clip(q, lower, upper).tolist()
        request.max_velocity = motion.velocity.tolist()
        request.max_acceleration = motion.acceleration.tolist()
        request.max_jerk = motion.jerk.tolist()
        trajectory = Trajectory(n)
        try:
            result = Ruckig(n).calculate(request, trajectory)
        except RuckigError as error:
            raise ImError(f"no jerk-limited way to the setpoint: {error}") from None
        if result not in (Result.Working, Result.Finished):
            raise ImError(f"no jerk-limited way to the setpoint: ruckig reports {result.name}")
        return np.array(trajectory.at_time(self._period))

    def _release(self, index: NDArray[np.intp], free: bool) -> None:
        self._free[index] = free
        self.cut[index] = False
        self._any_catching = bool(self.cut.any())
        self._bounds = self._bounds_of_free()

    def _bounds_of_free(self) -> NDArray[np.float64]:
        """Return bounds of every joint under control, in the order of the rows; none for the others."""
        half = (self._limits.upper - self._limits.lower) / 2.0
        return np.where(self._free, np.inf, np.vstack([self._leap, self._largest, half]))
