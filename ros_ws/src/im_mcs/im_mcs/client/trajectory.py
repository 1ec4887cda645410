"""Trajectories with times, as ``FollowJointTrajectory`` and ``/<group>/joint_trajectory`` bring them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from im_core.errors import DataError, ImError, NotFoundError
from im_mcs.client.points import JointsError, joint_order, ordered

UNSET = 0.0
"""A tolerance that is not given: the server's own holds."""
UNBOUNDED = -1.0
"""A tolerance that is switched off."""


class OldStampError(ImError):
    """A trajectory that ends before now."""

    default_code = "old_stamp"


@dataclass(frozen=True)
class Waypoint:
    """A point of a trajectory, in the order of its sender.

    Attributes:
        time_s: After the start of the trajectory [s].
        positions: Shape (n,) [rad or m].
        velocities: Shape (n,) or empty [rad/s or m/s].
        accelerations: Shape (n,) or empty [rad/s^2 or m/s^2].
        effort: Not supported: must be empty.
    """

    time_s: float
    positions: Sequence[float]
    velocities: Sequence[float] = ()
    accelerations: Sequence[float] = ()
    effort: Sequence[float] = ()


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
    """What a goal allows.

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
    """A trajectory as a client sends it.

    Attributes:
        joints: Names that its values are for, in any order.
        points: In the order of time.
        start_s: Testbed time at which it begins [s]; 0: at once.
        tolerances: What is allowed.
    """

    joints: Sequence[str]
    points: Sequence[Waypoint]
    start_s: float = 0.0
    tolerances: GoalTolerances = field(default_factory=GoalTolerances)


def trajectory_path(
    group: str, joints: Sequence[str], trajectory: TimedTrajectory, now_s: float, at_rest: Sequence[float] | None
) -> dict[str, Any]:
    """The ``path`` argument of a MOVE request.

    A start to come shifts all times; a group at rest stays where it is until then. Of a trajectory that began before
    now, the points to come are followed, as the joint trajectory controller of ros2_control does.

    Args:
        group: Name of the group.
        joints: Its joints, in order.
        trajectory: What is asked for.
        now_s: Testbed time [s].
        at_rest: Where the group is held, shape (n,) [rad or m]; None while it moves.

    Raises:
        JointsError: The joints are not the group's.
        OldStampError: The trajectory ends before now.
        DataError: No points, a wrong size, an effort, a time that does not grow, a value that is not finite, or a
            tolerance that is none.
    """
    order = joint_order(group, joints, _named(group, trajectory.joints))
    points = [_point(number, point, order, joints) for number, point in enumerate(trajectory.points, start=1)]
    if not points:
        raise DataError(f"the trajectory for group '{group}' has no points")
    _check_times(points)
    delay_s = trajectory.start_s - now_s if trajectory.start_s != 0.0 else 0.0
    if points[-1]["time"] + delay_s < 0.0:
        end_s = trajectory.start_s + points[-1]["time"]
        raise OldStampError(
            f"the trajectory ends at {end_s:.3f} s, {now_s - end_s:.3f} s before now ({now_s:.3f} s);"
            " give the header a stamp to come, or 0 for now",
            end=end_s,
            now=now_s,
        )
    points = [{**point, "time": point["time"] + delay_s} for point in points]
    if delay_s > 0.0 and at_rest is not None:
        points = [_hold(delay_s, at_rest, points[0]), *points] if points[0]["time"] > delay_s else points
    tolerances = trajectory.tolerances
    return {
        "kind": "trajectory",
        "points": points if delay_s >= 0.0 else _to_come(points),
        **_bounds(group, joints, tolerances.path, "path"),
        **_bounds(group, joints, tolerances.goal, "goal"),
        "goal_time_tolerance": _goal_time(tolerances.goal_time_s),
    }


def _named(group: str, joints: Sequence[str]) -> Sequence[str]:
    if not joints:
        raise JointsError(f"the trajectory for group '{group}' names no joints", group=group)
    return joints


def _point(number: int, point: Waypoint, order: Sequence[int], joints: Sequence[str]) -> dict[str, Any]:
    if len(point.effort):
        raise DataError(f"point {number} has efforts; only positions, velocities and accelerations can be followed")
    what = f"point {number}: "
    return {
        "time": point.time_s,
        "positions": ordered(point.positions, order, joints, what + "position"),
        "velocities": ordered(point.velocities, order, joints, what + "velocity") if len(point.velocities) else [],
        "accelerations": (
            ordered(point.accelerations, order, joints, what + "acceleration") if len(point.accelerations) else []
        ),
    }


def _hold(time_s: float, q: Sequence[float], like: Mapping[str, Any]) -> dict[str, Any]:
    """A point at rest at ``q`` that gives what the point ``like`` gives."""
    still = {name: [0.0] * len(q) if like[name] else [] for name in ("velocities", "accelerations")}
    return {"time": time_s, "positions": list(q), **still}


def _check_times(points: Sequence[Mapping[str, Any]]) -> None:
    before = -math.inf
    for number, point in enumerate(points, start=1):
        if point["time"] < 0.0:
            raise DataError(f"point {number}: time_from_start {point['time']:g} s is not >= 0", point=number)
        if point["time"] <= before:
            raise DataError(
                f"point {number}: time_from_start {point['time']:g} s does not come after that of the point before,"
                f" {before:g} s",
                point=number,
            )
        before = point["time"]


def _to_come(points: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [point for point in points if point["time"] >= 0.0]


def _bounds(group: str, joints: Sequence[str], tolerances: Sequence[Tolerance], where: str) -> dict[str, list[float]]:
    """Bounds of position and velocity in the order of the group; none if none are given."""
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
