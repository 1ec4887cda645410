"""Trajectories with times as they reach the servo process (JSON), and their checks."""

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.planning.joint_values import check_points, per_joint, within
from im_mcs.planning.values import as_amount, as_list, check_fields, is_number

if TYPE_CHECKING:
    from im_mcs.planning.context import PlanContext

TOLERANCES = ("path_tolerance", "path_velocity_tolerance", "goal_tolerance", "goal_velocity_tolerance")
"""Fields of a trajectory with a bound per joint, which are those of :class:`TrajectoryMove` too."""
_AT_REST = 1e-6
_POINT_NEEDS = {"time", "positions"}
_POINT_MAY = {"velocities", "accelerations"}


@dataclass(frozen=True)
class TrajectoryMove:
    """Positions at times.

    Attributes:
        times: Strictly increasing, shape (m,) [s].
        q: Positions, shape (m, n).
        v: Velocities, shape (m, n), if they are given.
        a: Accelerations, shape (m, n), if they are given.
        path_tolerance: Bound of the error on the way, shape (n,); 0: not set, below 0: none.
        path_velocity_tolerance: The same of the velocity.
        goal_tolerance: Bound of the error at the end, shape (n,); 0: not set, below 0: none.
        goal_velocity_tolerance: The same of the velocity.
        goal_time_s: Time allowed beyond the end to be within it; 0: as long as settling may take.
    """

    times: NDArray[np.float64]
    q: NDArray[np.float64]
    v: NDArray[np.float64] | None
    a: NDArray[np.float64] | None
    path_tolerance: NDArray[np.float64]
    path_velocity_tolerance: NDArray[np.float64]
    goal_tolerance: NDArray[np.float64]
    goal_velocity_tolerance: NDArray[np.float64]
    goal_time_s: float


def check_trajectory(context: "PlanContext", path: Mapping[str, Any]) -> TrajectoryMove:
    """A trajectory from JSON data whose fields are there.

    Raises:
        DataError: A point is not what it should be, times do not increase, or it does not end at rest.
        LimitError: A position, velocity or acceleration is beyond its limit.
    """
    given = as_list(path["points"], "points")
    most = context.config.planning.max_points
    if not 1 <= len(given) <= most:
        raise DataError(f"a trajectory of {len(given)} points is not one of 1 to {most}", points=len(given))
    for number, point in enumerate(given, start=1):
        if not isinstance(point, Mapping):
            raise DataError(f"point {number} is an object with time and positions, not {reprlib.repr(point)}")
        check_fields(point, _POINT_NEEDS, _POINT_MAY, f"point {number}")
    times = _times([point["time"] for point in given])
    q = check_points(context, [point["positions"] for point in given])
    v = _derivative(context, given, "velocities")
    a = _derivative(context, given, "accelerations")
    if a is not None and v is None:
        raise DataError("the trajectory has accelerations but no velocities; give both, or velocities alone")
    if v is not None and np.abs(v[-1]).max() > _AT_REST:
        k = int(np.argmax(np.abs(v[-1])))
        joint = context.limits.names[context.index[k]]
        raise DataError(
            f"a trajectory ends at rest; {joint} has velocity {v[-1, k]:.6g} in its last point", joint=joint
        )
    tolerances = {name: _tolerance(context, path.get(name, []), name) for name in TOLERANCES}
    goal_time_s = as_amount(path.get("goal_time_tolerance", 0.0), "goal_time_tolerance", "s")
    return TrajectoryMove(times, q, v, a, **tolerances, goal_time_s=goal_time_s)


def _times(values: Sequence[object]) -> NDArray[np.float64]:
    for number, value in enumerate(values, start=1):
        if not is_number(value) or float(value) < 0.0:
            raise DataError(f"point {number}: time {value} is not a finite number >= 0 [s]", point=number)
    times = np.array(values, dtype=np.float64)
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if late.size:
        k = int(late[0])
        raise DataError(
            f"times must increase: point {k + 2} is at {times[k + 1]:g} s, not after point {k + 1} at {times[k]:g} s",
            point=k + 2,
        )
    return times


def _derivative(context: "PlanContext", points: Sequence[Mapping[str, Any]], name: str) -> NDArray[np.float64] | None:
    rows = [
        per_joint(context, point.get(name, []), f"point {number}: {name}") for number, point in enumerate(points, 1)
    ]
    found = [row for row in rows if row is not None]
    if not found:
        return None
    if len(found) < len(rows):
        number = next(number for number, row in enumerate(rows, 1) if row is None)
        raise DataError(
            f"point {number} has no {name}, others have; give them for every point or for none", point=number
        )
    values = np.array(found)
    motion = context.limits.motion.of(context.index)
    limit, what, unit = (
        (motion.velocity, "velocity", "/s") if name == "velocities" else (motion.acceleration, "acceleration", "/s2")
    )
    for number, row in enumerate(values, start=1):
        within(context, row, limit, f"{what} of point {number}", unit)
    return values


def _tolerance(context: "PlanContext", values: object, what: str) -> NDArray[np.float64]:
    given = per_joint(context, values, what)
    return np.zeros(len(context.index)) if given is None else given
