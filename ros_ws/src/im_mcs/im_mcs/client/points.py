"""Points of a joint path in the order of a group."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, NotFoundError
from im_mcs.limits.limits import JointLimits

_ASTRAY = 1.0  # how far out of its range a joint may be found, as a share of it


class JointsError(DataError):
    """Joint names not of the group."""

    default_code = "joints"


def joint_order(group: str, joints: Sequence[str], given: Sequence[str]) -> list[int]:
    """Where each joint of a group stands among the given names.

    Args:
        group: Name of the group, for messages.
        joints: Joints of the group, in order.
        given: Names in any order; empty: those of the group in order.

    Returns:
        Shape (n,), for each joint of the group its rank in ``given``.

    Raises:
        JointsError: A name that is not the group's, one that is given twice, or one that is missing.
    """
    names = list(given) or list(joints)
    for name in names:
        if name not in joints:
            unknown = NotFoundError(kind=f"joint of group '{group}'", name=name, known=joints)
            raise JointsError(unknown.message, joint=name)
        if names.count(name) > 1:
            raise JointsError(f"joint '{name}' is given {names.count(name)} times", joint=name)
    missing = [name for name in joints if name not in names]
    if missing:
        raise JointsError(
            f"the path of group '{group}' lacks {', '.join(missing)}; all {len(joints)} joints are needed",
            missing=missing,
        )
    return [names.index(name) for name in joints]


def ordered(values: Sequence[float], order: Sequence[int], joints: Sequence[str], what: str) -> list[float]:
    """Values of one point in the order of the group.

    Args:
        values: As given, shape (n,).
        order: Rank of each joint in ``values``.
        joints: Joints of the group, in order.
        what: What they are, for messages, e.g. ``point 2: velocity``.

    Raises:
        DataError: A wrong size, or a value that is not finite; names the joint.
    """
    if len(values) != len(order):
        raise DataError(f"{what} is given for {len(values)} joints, {len(order)} are needed")
    result = [float(values[i]) for i in order]
    for joint, value in zip(joints, result, strict=True):
        if not math.isfinite(value):
            raise DataError(f"{what} of {joint} is {value}, not a finite number", joint=joint)
    return result


def ordered_points(
    group: str, joints: Sequence[str], given_joints: Sequence[str], points: Sequence[Sequence[float]]
) -> list[list[float]]:
    """Reorder points given for ``given_joints`` to the group's ``joints``.

    Args:
        group: Name of the group, for messages.
        joints: Joints of the group, in order.
        given_joints: Joints the points are given for; empty: those of the group in order.
        points: Positions of each point [rad or m].

    Raises:
        JointsError: A name that is not the group's, one that is given twice, or one that is missing.
        DataError: No points, a point of the wrong size, or a position that is not finite.
    """
    order = joint_order(group, joints, given_joints)
    if not points:
        raise DataError(f"the path of group '{group}' has no points")
    return [ordered(point, order, joints, f"point {number}: position") for number, point in enumerate(points, start=1)]


def check_measured_path(
    limits: JointLimits, index: NDArray[np.intp], points: Sequence[Sequence[float]], max_points: int
) -> NDArray[np.float64]:
    """Return points of a path from the group's measured place, possibly out of range, as an array, shape (m, n).

    Raises:
        DataError: None or too many points, a wrong size, or a value that is not finite.
        LimitError: A position after the first is out of its joint's range, or the first far out of it.
    """
    if not 1 <= len(points) <= max_points + 1:
        raise DataError(
            f"a path of {len(points)} points is not one of 1 to {max_points + 1}; the first is where the group is",
            points=len(points),
        )
    checked = [limits.check_positions(index, points[0], "point 1", _ASTRAY)]
    checked += [
        limits.check_positions(index, point, f"point {number}") for number, point in enumerate(points[1:], start=2)
    ]
    return np.array(checked)
