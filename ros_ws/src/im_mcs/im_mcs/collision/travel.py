"""How far bodies can travel towards each other when joints move: bounds that hold wherever the joints are."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_mcs.collision.bodies import Bodies, ancestors
from im_mcs.model import CellModel


def lever_bounds(model: CellModel, bodies: Bodies) -> NDArray[np.float64]:
    """Largest change of each pair's distance by unit motion of each joint, shape (pairs, joints) [m/rad or 1].

    A point that a revolute joint carries moves by at most the angle times its distance from the axis; that distance is
    at most what the offsets of the joints in between add up to. A joint that carries both bodies of a pair, or none of
    them, does not change their distance.

    Args:
        model: Kinematics.
        bodies: What is compared.
    """
    carried = np.zeros((len(bodies.names), model.n))
    for body, (joint, ends) in enumerate(bodies.ends):
        chain = ancestors(model, joint)[:-1]
        for rank, carrier in enumerate(chain):
            carried[body, carrier - 1] = _lever(model, carrier, chain[:rank][::-1], ends)
    first, second = carried[bodies.pairs[:, 0]], carried[bodies.pairs[:, 1]]
    return np.where((first > 0.0) & (second > 0.0), 0.0, first + second)


def _lever(model: CellModel, carrier: int, between: list[int], ends: NDArray[np.float64]) -> float:
    """Bound of the distance from the axis of ``carrier`` to the ends of a body, over the joints ``between``."""
    if model.cell.joints[carrier - 1].kind == "prismatic":
        return 1.0
    axis = _axis(model, carrier)
    if not between:
        return float(max(_off_axis(axis, end) for end in ends))
    offsets = [model.pin.jointPlacements[joint].translation for joint in between]
    along = [_off_axis(axis, offsets[0]), *(float(np.linalg.norm(offset)) for offset in offsets[1:])]
    return sum(along) + float(np.linalg.norm(ends, axis=1).max())


def _axis(model: CellModel, joint: int) -> NDArray[np.float64]:
    """Axis of a revolute joint in its own frame, shape (3,)."""
    data = model.pin.createData()
    q = pin.neutral(model.pin)
    jacobian = pin.computeJointJacobian(model.pin, data, q, joint)
    return np.asarray(jacobian[3:, joint - 1])


def _off_axis(axis: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.cross(axis, point)))
