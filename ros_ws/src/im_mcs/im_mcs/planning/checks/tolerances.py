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
    slope of the encoders: it is late by some milliseconds, and as noisy as they are coarse. Bounds of the client hold
    against the trajectory as it came, in its own time, the default against what is followed, perhaps later.

    Args:
        names: Joints.
        units: Of their positions.
        path: Bounds of the client on the way, shape (2, n); infinite: none.
        follow: Default bounds on the way, shape (2, n); infinite: none.
        goal: Bounds at the end, shape (2, n); infinite: none.
        goal_s: Time allowed beyond the end to be within ``goal`` [s]; 0: as long as settling may take.
    """

    def __init__(
        self,
        names: Sequence[str],
        units: Sequence[str],
        path: NDArray[np.float64],
        follow: NDArray[np.float64],
        goal: NDArray[np.float64],
        goal_s: float,
    ) -> None:
        self._names, self._units = names, units
        self._path, self._follow, self._goal, self._goal_s = path, follow, goal, goal_s

    def on_path(self, asked: NDArray[np.float64], followed: NDArray[np.float64], tick: int) -> ImError | None:
        """Return the fault of an error beyond the bound on the way.

        Args:
            asked: Error against the trajectory as it came, shape (2, n).
            followed: Error against the setpoint, shape (2, n).
            tick: Of the errors.
        """
        when = f"at tick {tick}"
        fault = self._fault(asked, self._path, "path_tolerance", when, tick)
        return fault or self._fault(followed, self._follow, "path_tolerance", when, tick)

    def reached(self, error: NDArray[np.float64]) -> bool:
        """Return whether errors, shape (2, n), are within the bounds at the end."""
        return bool((np.abs(error) <= self._goal).all())

    def at_goal(self, error: NDArray[np.float64], late_s: float, settled: bool, tick: int) -> ImError | None:
        """Return the fault of an error beyond the bound after the allowed time.

        Args:
            error: Against the end, shape (2, n).
            late_s: Time since the end of the trajectory as it came [s].
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


def tolerances_of(context: PlanContext, move: Move, *, yields: bool = False) -> TrajectoryTolerances | None:
    """Return the tolerances of a trajectory; 0 is the default, below 0 none.

    The default on the way is the bound of the following error; that of the end is configured.

    Args:
        context: Of the group.
        move: What is asked for.
        yields: Whether the law in force lets the arm stand wherever it is pushed: then no default holds for the place.

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
    path = _bounds(given[0], given[1], np.inf, np.inf)
    follow = np.array([np.where(given[0] == 0.0, limits.following_error[index], np.inf), np.full(len(index), np.inf)])
    names, units = [limits.names[i] for i in index], [limits.units[i] for i in index]
    default = context.config.planning.goal
    ends = np.array([np.inf if yields else default.rad if unit == "rad" else default.m for unit in units])
    goal = _bounds(given[2], given[3], ends, default.stopped_velocity)
    return TrajectoryTolerances(names, units, path, follow, goal, move.goal_time_tolerance)


def _bounds(
    q: NDArray[np.float64], v: NDArray[np.float64], default_q: NDArray[np.float64] | float, default_v: float
) -> NDArray[np.float64]:
    """Return bounds of positions and velocities, shape (2, n)."""
    bounds = np.array([np.where(q == 0.0, default_q, q), np.where(v == 0.0, default_v, v)])
    return np.where(bounds < 0.0, np.inf, bounds)
