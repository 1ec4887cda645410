"""``trajectory_msgs/JointTrajectory`` and goals of ``FollowJointTrajectory`` from clients, as plain data."""

from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from im_core.errors import DataError
from im_mcs.client.trajectory import GoalTolerances, TimedTrajectory, Tolerance
from im_mcs.ros.bounds import MOST_VALUES, check_length


def timed_trajectory(message: JointTrajectory) -> TimedTrajectory:
    """Read a trajectory.

    Raises:
        DataError: A point does not have one value for each joint, or not the quantities that the others have.
    """
    points, joints = message.points, message.joint_names
    number = next((number for number, point in enumerate(points, start=1) if point.effort), 0)
    if number:
        raise DataError(f"point {number} has efforts; only positions, velocities and accelerations can be followed")
    times = np.array([_seconds(point.time_from_start) for point in points])
    q = _column([point.positions for point in points], "positions", "position", len(joints))
    assert q is not None
    v = _velocities([point.velocities for point in points], times, q)
    a = _column([point.accelerations for point in points], "accelerations", "acceleration", len(joints))
    return TimedTrajectory(joints, times, q, v, a, _seconds(message.header.stamp))


def goal_tolerances(goal: FollowJointTrajectory.Goal) -> GoalTolerances:
    """Read the tolerances of a goal.

    Raises:
        DataError: There are too many, or some for joints of several degrees of freedom.
    """
    multi = goal.multi_dof_trajectory
    for name, given in (
        ("multi_dof_trajectory", multi.joint_names or multi.points),
        ("component_path_tolerance", goal.component_path_tolerance),
        ("component_goal_tolerance", goal.component_goal_tolerance),
    ):
        if given:
            raise DataError(f"{name} is not empty; the joints here have one degree of freedom each")
    path = _tolerances(goal.path_tolerance, "path_tolerance")
    return GoalTolerances(path, _tolerances(goal.goal_tolerance, "goal_tolerance"), _seconds(goal.goal_time_tolerance))


def _velocities(
    rows: "list[array[float]]", times: NDArray[np.float64], q: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Velocities of all points, shape (m, n); None where no point has any.

    A point without velocities is passed with the harmonic mean of the slopes on both sides, with 0 where a joint turns
    round, so that no joint swings beyond the point (F. N. Fritsch, J. Butland, "A method for constructing local
    monotone piecewise cubic interpolants", 1984); a first one with the slope behind it; the last one is a rest.
    """
    missing = np.array([not row for row in rows])
    if missing.all() or not missing.any():
        return _column(rows, "velocities", "velocity", q.shape[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.diff(q, axis=0) / np.diff(times)[:, None]
        before, after = np.vstack([slope[:1], slope]), np.vstack([slope, np.zeros_like(slope[:1])])
        own = np.where(before * after > 0.0, 2.0 * before * after / (before + after), 0.0)
    filled = [array("d", own[k]) if lacks else row for k, (row, lacks) in enumerate(zip(rows, missing, strict=True))]
    return _column(filled, "velocities", "velocity", q.shape[1])


def _column(rows: "list[array[float]]", field: str, quantity: str, n: int) -> NDArray[np.float64] | None:
    """Values of all points, shape (m, n); None where no point has any, but for positions."""
    sizes = list(map(len, rows))
    if field != "positions" and not any(sizes):
        return None
    for number, size in enumerate(sizes, start=1) if set(sizes) - {n} else ():
        if not size and field != "positions":
            raise DataError(f"point {number} has no {field}, others have; give them for every point or for none")
        if size != n:
            raise DataError(f"point {number}: {quantity} is given for {size} joints, {n} are needed", point=number)
    return np.frombuffer(b"".join(rows)).reshape(len(rows), n)


def _tolerances(given: Sequence[JointTolerance], name: str) -> list[Tolerance]:
    check_length(given, name, MOST_VALUES)
    return [Tolerance(each.name, each.position, each.velocity, each.acceleration) for each in given]


def _seconds(time: Time | Duration) -> float:
    return float(time.sec + 1e-9 * time.nanosec)
