"""Paths as they reach the servo process (JSON), and their checks; what is wrong is said before anything moves."""

import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, LimitError
from im_mcs.planning.joint_values import check_points, per_joint, within
from im_mcs.planning.pose_values import check_pose
from im_mcs.planning.trajectory_arguments import TOLERANCES, TrajectoryMove, check_trajectory
from im_mcs.planning.values import as_amount, as_list, as_numbers, check_fields, is_number

if TYPE_CHECKING:
    from im_mcs.planning.context import PlanContext

SLOWEST = 0.01
"""Smallest scale of speed: a motion slowed down further would seem to stand, and never end."""
_FIELDS = {
    "joint": ({"points"}, {"blend"}),
    "line": ({"poses"}, {"speed", "blend"}),
    "trajectory": ({"points"}, {*TOLERANCES, "goal_time_tolerance"}),
}


class Policy(StrEnum):
    """What becomes of a motion that is under way when another is asked for."""

    REFUSE = "refuse"
    APPEND = "append"
    REPLACE = "replace"


@dataclass(frozen=True)
class JointMove:
    """Points to pass in joint space, shape (m, n), with rounded corners if ``blend`` > 0."""

    points: NDArray[np.float64]
    blend: float


@dataclass(frozen=True)
class LineMove:
    """Straight lines of the wrist.

    Attributes:
        poses: x, y, z, qx, qy, qz, qw of each, with quaternions of length 1.
        speed: Of the wrist [m/s]; 0: as fast as limits allow.
        blend: [m]; 0: at rest in every pose.
    """

    poses: list[list[float]]
    speed: float
    blend: float


Move = JointMove | LineMove | TrajectoryMove


def check_move(context: "PlanContext", path: object) -> Move:
    """A path from JSON data.

    Raises:
        DataError: It is not of the schema: a kind that does not exist, a field missing or unknown, a wrong size, a
            value that is not finite, times that do not increase, a motion that does not end at rest.
        LimitError: A position, velocity or acceleration is beyond its limit; names joint, value, limit and unit.
    """
    if not isinstance(path, Mapping):
        raise DataError(f"a path is an object with a kind, not {reprlib.repr(path)}")
    kind = path.get("kind")
    if not isinstance(kind, str) or kind not in _FIELDS:
        raise DataError(f"path: kind {reprlib.repr(kind)} is not one of {', '.join(_FIELDS)}", kind=str(kind))
    needs, may = _FIELDS[kind]
    check_fields(path, needs | {"kind"}, may, f"path of kind {kind}")
    if kind == "joint":
        blend = as_amount(path.get("blend", 0.0), "blend", "rad or m")
        return JointMove(check_points(context, path["points"]), blend)
    if kind == "line":
        return _line(context, path)
    return check_trajectory(context, path)


def check_stream(
    context: "PlanContext", arguments: Mapping[str, Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position and velocity of a streaming setpoint, shape (n,) each.

    Raises:
        DataError: A wrong size, or a value that is not finite.
        LimitError: A position is out of range, a velocity too large, or the joint could not stop before its limit.
    """
    limits, index = context.limits, context.index
    q = limits.check_positions(index, as_numbers(arguments["positions"], "positions"), "the setpoint")
    v = per_joint(context, arguments.get("velocities", []), "velocities")
    if v is None:
        return q, np.zeros_like(q)
    motion = limits.motion.of(index)
    within(context, v, motion.velocity, "velocity of the setpoint", "/s")
    speed = np.abs(v)
    way = speed * (speed / motion.acceleration + motion.acceleration / motion.jerk) / 2.0
    stop = q + np.sign(v) * way
    beyond = (stop < limits.lower[index]) | (stop > limits.upper[index])
    if beyond.any():
        k = int(np.argmax(beyond))
        i = index[k]
        limit = float(limits.lower[i] if v[k] < 0.0 else limits.upper[i])
        raise LimitError(
            joint=limits.names[i],
            value=float(stop[k]),
            limit=limit,
            unit=limits.units[i],
            what=f"position at which it could stop from the setpoint's velocity {v[k]:.6g} {limits.units[i]}/s",
        )
    return q, v


def check_speed_scale(value: object) -> float:
    """Speed scale of a motion; 0 stands for 1.

    Raises:
        DataError: It is neither 0 nor between :data:`SLOWEST` and 1.
    """
    if not is_number(value) or (value != 0.0 and not SLOWEST <= value <= 1.0):
        told = f"speed_scale {reprlib.repr(value)} is not between {SLOWEST:g} and 1 (0 stands for 1)"
        raise DataError(told, value=str(value))
    return float(value) or 1.0


def check_policy(value: object) -> Policy:
    """What to do with a motion under way.

    Raises:
        DataError: There is no such policy.
    """
    if value not in tuple(Policy):
        raise DataError(f"policy {reprlib.repr(value)} is not one of {', '.join(Policy)}", policy=str(value))
    return Policy(str(value))


def _line(context: "PlanContext", path: Mapping[str, Any]) -> LineMove:
    given = as_list(path["poses"], "poses")
    most = context.config.planning.max_points
    if not 1 <= len(given) <= most:
        raise DataError(f"a line through {len(given)} poses is not one of 1 to {most}", poses=len(given))
    poses = []
    for number, pose in enumerate(given, start=1):
        try:
            poses.append(check_pose(pose))
        except DataError as error:
            raise DataError(f"pose {number} of the line: {error.message}", pose=number) from None
    speed = as_amount(path.get("speed", 0.0), "speed", "m/s")
    return LineMove(poses, speed, as_amount(path.get("blend", 0.0), "blend", "m"))
