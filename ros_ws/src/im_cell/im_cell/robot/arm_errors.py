"""Errors of an arm's kinematics: each joint stands turned and shifted a little from the drawing.

The zero of a joint is known less well than the direction of its axis. A gear is off by a sine of one and of two periods
a turn of its joint. Source: B. Mooring, Z. Roth, M. Driels,
"Fundamentals of Manipulator Calibration" (1991), chapter 2.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from im_cell.robot.cell import Cell
from im_cell.robot.tree import WORLD, Joint
from im_cell.rotations import cross_matrix, matrix_of_rpy, matrix_of_vector

Array = NDArray[np.float64]

_TURN_RAD, _ZERO_RAD, _SHIFT_M, _GEAR_RAD = 3e-4, 1e-3, 2e-4, 3e-4


def usual_errors(joint: Joint) -> Array:
    """Return usual sizes of the errors of a joint.

    Returns:
        Of turns and shifts along the axes of its frame, and of a revolute joint of its :func:`gear_waves`, shape (6,)
        or (10,) [rad, m, rad].
    """
    turns, shifts, waves = np.full(3, _TURN_RAD), np.full(3, _SHIFT_M), np.full(4, _GEAR_RAD)
    if joint.kind != "revolute":
        return np.concatenate((turns, shifts))
    return np.concatenate((np.hypot(np.abs(joint.axis) * _ZERO_RAD, turns), shifts, waves))


def gear_waves(positions: Array) -> Array:
    """Return sine and cosine of one and of two periods a turn at joint positions, shape (..., 4) [-]."""
    return np.stack([wave(periods * positions) for periods in (1, 2) for wave in (np.sin, np.cos)], axis=-1)


def kinematic_derivatives(cell: Cell, frame: str, positions: Mapping[str, float], offset: Array) -> Array:
    """Return the derivatives of a point by the errors of all joints below, each in units of the usual size.

    Args:
        cell: The cell as drawn.
        frame: Frame of the point.
        positions: Of joints, by name [rad or m]; others stand at home.
        offset: The point in the frame, shape (3,) [m].

    Returns:
        In the world, joint by joint as :meth:`im_cell.robot.Cell.carriers_of`: turns, shifts, and of a revolute joint
        sine and cosine of one and of two periods, shape (3, k) [m].
    """
    at = dict(zip(cell.joint_names, cell.home.tolist(), strict=True)) | dict(positions)
    by_child = {joint.child: joint for joint in cell.joints}
    place = cell.tree.carrier(frame)
    rotation, origin = place.matrices()
    point, link, columns = rotation @ offset + origin, place.parent, np.zeros((3, 0))
    while link != WORLD:  # point and columns in the frame of the link, then in that of its joint, then in the parent's
        joint = by_child[link]
        along = at[joint.name] * np.array(joint.axis)
        turn = matrix_of_vector(along) if joint.kind == "revolute" else np.eye(3)
        point = turn @ point if joint.kind == "revolute" else point + along
        own = np.hstack((-cross_matrix(point), np.eye(3)))
        if joint.kind == "revolute":
            own = np.hstack((own, np.outer(np.cross(joint.axis, point), gear_waves(np.array(at[joint.name])))))
        own = own * usual_errors(joint)
        stand = matrix_of_rpy(joint.rpy)
        columns = stand @ np.hstack((own, turn @ columns))
        point, link = stand @ point + joint.xyz, joint.parent
    return columns
