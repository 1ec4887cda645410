"""Trajectories with times, of ``FollowJointTrajectory`` and ``/<group>/joint_trajectory``."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, ImError, NotFoundError
from im_mcs.client.points import JointsError, joint_order
from im_mcs.protocol.points import TimedPoints, pack_points
from im_mcs.protocol.requests import LARGEST

UNSET = 0.0
"""A tolerance that is not given: the server's own holds."""
UNBOUNDED = -1.0
"""A tolerance that is switched off."""
STREAM_S = 0.5
"""What ends no further ahead than this, on the topic, is a window of a stream [s]."""
LATE_S = 0.1
"""How long ago a window of a stream may have ended [s]."""
_AT_REST = 1e-6


class OldStampError(ImError):
    """Trajectory with the end before now."""

    default_code = "old_stamp"


@dataclass(frozen=True)
class Tolerance:
    """How far a joint may be off: above 0 a bound, 0 the server's default, -1 none.

    Accelerations are not measured, and cannot have a bound.
    """

    joint: str
    position: float
    velocity: float = UNSET
    acceleration: float = UNSET


@dataclass(frozen=True)
class GoalTolerances:
    """Tolerances of a goal.

    Attributes:
        path: On the way.
        goal: At the end.
        goal_time_s: How long after the end the goal may still be reached [s]; 0: the server's default.
    """

    path: Sequence[Tolerance] = ()
    goal: Sequence[Tolerance] = ()
    goal_time_s: float = 0.0


@dataclass(frozen=True)
class TimedTrajectory:
    """Trajectory in a client's form.

    Attributes:
        joints: Names that its values are for, in any order.
        times: After the start, shape (m,) [s].
        q: Positions, shape (m, k) [rad or m].
        v: Velocities, shape (m, k) [rad/s or m/s], if there are any.
        a: Accelerations, shape (m, k) [rad/s^2 or m/s^2], if there are any.
        start_s: Testbed time at which it begins [s]; 0: at once.
        tolerances: What is allowed.
    """

    joints: Sequence[str]
    times: NDArray[np.float64]
    q: NDArray[np.float64]
    v: NDArray[np.float64] | None = None
    a: NDArray[np.float64] | None = None
    start_s: float = 0.0
    tolerances: GoalTolerances = field(default_factory=GoalTolerances)


@dataclass(frozen=True)
class Accepted:
    """Accepted forms of trajectories beyond whole ones with rest at the end.

    Attributes:
        partial_joints: Some of the joints only; the others hold.
        end_velocity: A velocity in the last point; the motion decelerates behind it.
    """

    partial_joints: bool = False
    end_velocity: bool = False


STRICT = Accepted()


@dataclass(frozen=True)
class Present:
    """Present motion of a group at the arrival of a trajectory.

    Attributes:
        now_s: Testbed time [s].
        q: Setpoint, shape (n,) [rad or m].
        at_rest: Whether it stands still there.
    """

    now_s: float
    q: NDArray[np.float64]
    at_rest: bool


@dataclass(frozen=True)
class Course(TimedPoints):
    """Points in time from now on, in the order of the group."""

    def held(self, time_s: float, q: NDArray[np.float64]) -> "Course":
        """Return the course with a preceding point at rest at ``q``, shape (n,)."""
        v, a = (None if x is None else np.vstack([np.zeros_like(q), x]) for x in (self.v, self.a))
        return Course(np.append(time_s, self.times), np.vstack([q, self.q]), v, a)


def trajectory_path(
    group: str,
    joints: Sequence[str],
    trajectory: TimedTrajectory,
    present: Present,
    accepted: Accepted = STRICT,
    *,
    stream: bool = False,
) -> dict[str, Any]:
    """Return the path of a group, as the ``path`` of a MOVE request.

    A start to come shifts all times; a group at rest stays where it is until then. Of a trajectory that began before
    now, the points to come are followed, as the joint trajectory controller of ros2_control does.

    Args:
        group: Name of the group.
        joints: Its joints, in order.
        trajectory: What is asked for.
        present: What the group does now.
        accepted: What is accepted.
        stream: Whether what ends not far ahead is a window of a stream: followed from now on in its own time, and left
            with its last velocity until the next one comes.

    Raises:
        JointsError: The joints are not the group's.
        OldStampError: The trajectory ends before now, a window of a stream some moments before.
        DataError: No points, a time that does not grow, a value that is not finite, a velocity at the end, a start too
            far ahead, or a tolerance that is none.
    """
    course = _course(group, joints, trajectory, present.q, accepted)
    delay_s = trajectory.start_s - present.now_s if trajectory.start_s != 0.0 else 0.0
    if stream and course.times[-1] + delay_s <= STREAM_S:
        _check_stamp(trajectory, present.now_s, delay_s + LATE_S)
        start_ns = round(trajectory.start_s * 1e9)
        return {"kind": "trajectory", "points": pack_points(course), "stream": True, "start_ns": start_ns}
    if not accepted.end_velocity:
        _check_end(course, joints)
    _check_stamp(trajectory, present.now_s, delay_s)
    course = course.since(int(np.argmax(course.times + delay_s >= 0.0)), delay_s)
    if delay_s > 0.0 and present.at_rest and course.times[0] > delay_s:
        course = course.held(delay_s, present.q)
    tolerances = trajectory.tolerances
    return {
        "kind": "trajectory",
        "points": pack_points(course),
        **_bounds(group, joints, tolerances.path, "path"),
        **_bounds(group, joints, tolerances.goal, "goal"),
        "goal_time_tolerance": _goal_time(tolerances.goal_time_s),
    }


def joint_ranks(
    group: str, joints: Sequence[str], names: Sequence[str], accepted: Accepted
) -> tuple[list[int], list[str]]:
    """Return the rank of each joint of a group among given and missing names; and the missing ones.

    Raises:
        JointsError: The names are not the group's, or not all that are needed.
    """
    if not names:
        raise JointsError(f"the trajectory for group '{group}' names no joints", group=group)
    missing = [joint for joint in joints if joint not in names] if accepted.partial_joints else []
    return joint_order(group, joints, [*names, *missing]), missing


def _course(
    group: str, joints: Sequence[str], trajectory: TimedTrajectory, held: NDArray[np.float64], accepted: Accepted
) -> Course:
    """Return the points in the order of the group; joints without a name hold."""
    order, missing = joint_ranks(group, joints, trajectory.joints, accepted)
    if not len(trajectory.times):
        raise DataError(f"the trajectory for group '{group}' has no points")
    _check_times(trajectory.times)
    rest = held[[joints.index(joint) for joint in missing]]

    def whole(values: NDArray[np.float64], others: NDArray[np.float64], what: str) -> NDArray[np.float64]:
        columns = np.hstack([values, np.tile(others, (len(values), 1))])[:, order]
        _check_finite(columns, joints, what)
        return columns

    still = np.zeros_like(rest)
    return Course(
        trajectory.times,
        whole(trajectory.q, rest, "position"),
        None if trajectory.v is None else whole(trajectory.v, still, "velocity"),
        None if trajectory.a is None else whole(trajectory.a, still, "acceleration"),
    )


def _check_finite(values: NDArray[np.float64], joints: Sequence[str], what: str) -> None:
    if not np.isfinite(values).all():
        number, k = (int(i) for i in np.argwhere(~np.isfinite(values))[0])
        value, joint = float(values[number, k]), joints[k]
        raise DataError(f"point {number + 1}: {what} of {joint} is {value}, not a finite number", joint=joint)


def _check_times(times: NDArray[np.float64]) -> None:
    if times[0] < 0.0:
        raise DataError(f"point 1: time_from_start {times[0]:g} s is not >= 0", point=1)
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if late.size:
        k = int(late[0])
        raise DataError(
            f"point {k + 2}: time_from_start {times[k + 1]:g} s does not come after that of the point before,"
            f" {times[k]:g} s",
            point=k + 2,
        )


def _check_end(course: Course, joints: Sequence[str]) -> None:
    if course.v is not None and np.abs(course.v[-1]).max() > _AT_REST:
        k = int(np.argmax(np.abs(course.v[-1])))
        raise DataError(
            f"a trajectory ends at rest; {joints[k]} has velocity {course.v[-1, k]:.6g} in its last point"
            " (the parameter allow_nonzero_velocity_at_trajectory_end allows it)",
            joint=joints[k],
        )


def _check_stamp(trajectory: TimedTrajectory, now_s: float, delay_s: float) -> None:
    end_s = trajectory.start_s + float(trajectory.times[-1])
    if trajectory.times[-1] + delay_s < 0.0:
        raise OldStampError(
            f"the trajectory ends at {end_s:.3f} s, {now_s - end_s:.3f} s before now ({now_s:.3f} s);"
            " give the header a stamp to come, or 0 for now",
            end=end_s,
            now=now_s,
        )
    if delay_s > LARGEST:
        raise DataError(
            f"the trajectory begins {delay_s:.3g} s from now (testbed time {now_s:.3f} s), up to {LARGEST:g} s are "
            "allowed: is its stamp of another clock?",
            start=trajectory.start_s,
            now=now_s,
        )


def _bounds(group: str, joints: Sequence[str], tolerances: Sequence[Tolerance], where: str) -> dict[str, list[float]]:
    """Return bounds of position and velocity in the order of the group; none if none are given."""
    position, velocity = dict.fromkeys(joints, UNSET), dict.fromkeys(joints, UNSET)
    for tolerance in tolerances:
        name = tolerance.joint
        if name not in position:
            unknown = NotFoundError(kind=f"joint of group '{group}'", name=name, known=joints)
            raise JointsError(f"{where}_tolerance: {unknown.message}", joint=name)
        _check_tolerance(tolerance, f"{where}_tolerance of {name}")
        position[name], velocity[name] = tolerance.position, tolerance.velocity
    values = {f"{where}_tolerance": position, f"{where}_velocity_tolerance": velocity}
    return {name: list(bounds.values()) if tolerances else [] for name, bounds in values.items()}


def _check_tolerance(tolerance: Tolerance, what: str) -> None:
    for quantity in ("position", "velocity", "acceleration"):
        value = getattr(tolerance, quantity)
        if not (math.isfinite(value) and (value >= 0.0 or value == UNBOUNDED)):
            raise DataError(
                f"{what}: {quantity} {value:g} is neither a bound, nor 0 (default), nor -1 (none)",
                joint=tolerance.joint,
            )
    if tolerance.acceleration > 0.0:
        raise DataError(
            f"{what}: accelerations are not measured and cannot have a bound, only positions and velocities",
            joint=tolerance.joint,
        )


def _goal_time(seconds: float) -> float:
    if seconds < 0.0:
        raise DataError(f"goal_time_tolerance {seconds:g} s is not >= 0")
    return seconds
