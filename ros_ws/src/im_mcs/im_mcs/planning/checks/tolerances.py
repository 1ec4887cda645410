"""Tolerances of a trajectory, as defined by ros2_controllers' ``JointTrajectoryController``."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.planning.checks.admission import per_joint
from im_mcs.planning.checks.context import PlanContext
from im_mcs.protocol.requests import Move, TrajectoryMove


class TrajectoryTolerances:
    """Bounds of the errors of position and velocity, on the way and at the end.

    An error has shape (2, n): position [rad or m], and velocity [rad/s or m/s], which is measured as the filtered
    slope of the encoders: it is late by some milliseconds, and as noisy as they are coarse.

    Args:
        names: Joints.
        units: Of their positions.
        path: Bounds on the way, shape (2, n); infinite: none.
        goal: Bounds at the end, shape (2, n); infinite: none.
        goal_s: Time allowed beyond the end to be within ``goal`` [s]; 0: as long as settling may take.
    """

    def __init__(
        self,
        names: Sequence[str],
        units: Sequence[str],
        path: NDArray[np.float64],
        goal: NDArray[np.float64],
        goal_s: float,
    ) -> None:
        self._names, self._units = names, units
        self._path, self._goal, self._goal_s = path, goal, goal_s
        self.judges_goal = bool(np.isfinite(goal).any())

    def on_path(self, error: NDArray[np.float64], tick: int) -> ImError | None:
        """Return the fault of an error, shape (2, n), beyond the bound on the way."""
        return self._fault(error, self._path, "path_tolerance", f"at tick {tick}", tick)

    def reached(self, error: NDArray[np.float64]) -> bool:
        """Return whether errors, shape (2, n), are within the bounds at the end."""
        return bool((np.abs(error) <= self._goal).all())

    def at_goal(self, error: NDArray[np.float64], late_s: float, settled: bool, tick: int) -> ImError | None:
        """Return the fault of an error beyond the bound after the allowed time.

        Args:
            error: Shape (2, n).
            late_s: Time since the end [s].
            settled: Whether the joints have settled, or have been given up on.
            tick: Of the error.
        """
        over = late_s > self._goal_s if self._goal_s > 0.0 else settled
        if not over:
            return None
        when = f"{late_s:.3f} s after the end, at tick {tick}"
        return self._fault(error, self._goal, "goal_tolerance", when, tick)

    def _fault(
        self, error: NDArray[np.float64], bound: NDArray[np.float64], code: str, when: str, tick: int
    ) -> ImError | None:
        beyond = np.abs(error) > bound
        if not beyond.any():
            return None
        of_velocity, k = divmod(int(np.argmax(beyond)), len(self._names))
        joint, value, limit = self._names[k], float(error[of_velocity, k]), float(bound[of_velocity, k])
        unit = self._units[k] + ("/s" if of_velocity else "")
        what, quantity = code.replace("_", " "), "velocity error" if of_velocity else "error"
        return ImError(
            f"{joint}: {quantity} {value:.6g} {unit} is beyond the {what} {limit:.6g} {unit} {when}",
            code=code,
            joint=joint,
            value=value,
            limit=limit,
            unit=unit,
            tick=tick,
        )


def tolerances_of(context: PlanContext, move: Move) -> TrajectoryTolerances | None:
    """Return the tolerances of a trajectory; 0 is the bound of the following error, below 0 none.

    Raises:
        DataError: Not as many bounds as joints, or one is not finite.
    """
    if not isinstance(move, TrajectoryMove):
        return None
    limits, index = context.limits, context.index
    unset, given = np.zeros(len(index)), []
    for name in ("path_tolerance", "path_velocity_tolerance", "goal_tolerance", "goal_velocity_tolerance"):
        bounds = per_joint(context, getattr(move, name), name)
        given.append(unset if bounds is None else bounds)
    path = _bounds(given[0], given[1], limits.following_error[index])
    goal = _bounds(given[2], given[3], np.inf)
    names, units = [limits.names[i] for i in index], [limits.units[i] for i in index]
    return TrajectoryTolerances(names, units, path, goal, move.goal_time_tolerance)


def _bounds(
    q: NDArray[np.float64], v: NDArray[np.float64], default: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Return bounds of positions and velocities, shape (2, n); there is no default for velocities."""
    bounds = np.array([np.where(q == 0.0, default, q), np.where(v == 0.0, np.inf, v)])
    return np.where(bounds < 0.0, np.inf, bounds)
