"""Closed-form inverse kinematics of arms with a spherical wrist, or with three parallel axes as of Universal Robots."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_mcs.inverse.arm import ARM_JOINTS
from im_mcs.model import CellModel

# How far axes may be from parallel [rad], and from meeting [m]: a right angle is written 1.5708 in many a URDF.
_PARALLEL, _MEETING_M = 2e-5, 2e-5
# A turn that is not determined, lengths [m or 1], and a cosine that counts as 1.
_FREE, _STRETCHED = 1e-9, 1e-9

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ClosedForm:
    """Solutions of six revolute axes, up to eight a pose, by turns of points and directions about axes.

    The sub-problems are those of B. Paden ("Kinematics and control of robot manipulators", 1986), and the order is
    that of A.J. Elias, J.T. Wen ("IK-Geo", 2022). With axes 2 and 3 parallel, and 4, 5 and 6 through one point, the
    point tells joints 1, 3 and 2; the orientation tells the wrist. With axes 2, 3 and 4 parallel, and 5 and 6 through
    one point, joint 1 follows from the point's distance along the parallel axes, joints 5 and 6 from the orientation,
    and the rest is a triangle.

    Attributes:
        base: Joint of pinocchio's model that the first axis belongs to.
        axes: Directions at position 0, in the frame of the first joint, shape (6, 3).
        points: A point on each axis, shape (6, 3) [m].
        tip: Pose of the wrist at position 0.
        centre: Where the last two or three axes meet, shape (3,) [m].
        spherical: Whether the last three meet; else the second to fourth are parallel.
    """

    base: int
    axes: Array
    points: Array
    tip: pin.SE3
    centre: Array
    spherical: bool

    @classmethod
    def of(cls, model: CellModel, frame: str, joints: NDArray[np.intp]) -> Self | None:
        """Return the closed form of an arm; None where the arm is built otherwise.

        Args:
            model: Kinematics.
            frame: The wrist.
            joints: Ranks of the arm's joints, base first.
        """
        if len(joints) != ARM_JOINTS:
            return None
        data, base = model.pin.createData(), int(joints[0]) + 1
        columns = pin.computeJointJacobians(model.pin, data, pin.neutral(model.pin))[:, joints]
        pin.updateFramePlacements(model.pin, data)
        twists = [data.oMi[base].actInv(pin.Motion(column)) for column in columns.T]
        axes = np.array([twist.angular for twist in twists])
        if not axes.any(axis=1).all():  # a joint slides
            return None
        points = np.array([np.cross(twist.angular, twist.linear) for twist in twists])
        tip = data.oMi[base].actInv(data.oMf[model.frame_id(frame)])
        for first, parallel in ((3, (1, 2)), (4, (1, 2, 3))):
            centre = _meeting(axes[first:], points[first:])
            across = np.linalg.norm(np.cross(axes[1], axes[list(parallel)]), axis=1)
            if centre is not None and across.max() < _PARALLEL:
                return cls(base, axes, points, tip, centre, first == 3)
        return None

    def solve(self, model: CellModel, target: pin.SE3, q_all: Array, joints: NDArray[np.intp]) -> Iterator[Array]:
        """Positions of the arm for a pose, up to eight, shape (6,) each [rad], regardless of limits and of full turns.

        A joint that the pose leaves free stays where it is.

        Args:
            model: Kinematics.
            target: Wanted pose of the wrist in ``world``.
            q_all: Positions of all joints; those of the arm are where free joints stay, shape (n,) [rad or m].
            joints: Ranks of the arm's joints.
        """
        still, data = q_all.copy(), model.pin.createData()
        still[joints] = 0.0
        pin.forwardKinematics(model.pin, data, still)
        moved = data.oMi[self.base].actInv(target) * self.tip.inverse()
        yield from (self._by_wrist if self.spherical else self._by_plane)(moved, q_all[joints])

    def _first(self, moved: pin.SE3, here: Array) -> Iterator[tuple[float, pin.SE3]]:
        """Positions of joint 1, with the rest of the motion for the others."""
        (h1, h2), p1 = self.axes[:2], self.points[0]
        for q1 in _turns(-h1, moved.act(self.centre) - p1, h2, float(h2 @ (self.centre - p1)), here[0]):
            yield q1, _about(h1, p1, -q1) * moved

    def _triangle(self, start: Array, end: Array, here: Array) -> Iterator[tuple[float, float]]:
        """Positions of joints 2 and 3 for bringing a point to another place."""
        h, p2, p3 = self.axes[1], self.points[1], self.points[2]
        arm, back, way = start - p3, p2 - p3, end - p2
        for q3 in _turns(h, arm, back, float(arm @ arm + back @ back - way @ way) / 2.0, here[2]):
            yield _turn(h, _rotated(h, q3, arm) - back, way, here[1]), q3

    def _by_wrist(self, moved: pin.SE3, here: Array) -> Iterator[Array]:
        (_, h2, _, h4, h5, h6), p = self.axes, self.points
        for q1, left in self._first(moved, here):
            for q2, q3 in self._triangle(self.centre, left.act(self.centre), here):
                turn = (_about(h2, p[2], -q3) * _about(h2, p[1], -q2) * left).rotation
                for q5 in _turns(h5, h6, h4, float(h4 @ turn @ h6), here[4]):
                    q4 = _turn(h4, _rotated(h5, q5, h6), turn @ h6, here[3])
                    q6 = _angle(h6, pin.exp3(-q5 * h5) @ pin.exp3(-q4 * h4) @ turn)
                    yield np.array([q1, q2, q3, q4, q5, q6])

    def _by_plane(self, moved: pin.SE3, here: Array) -> Iterator[Array]:
        (_, h, _, _, h5, h6), p = self.axes, self.points
        for q1, left in self._first(moved, here):
            turn = left.rotation
            for q5 in _turns(h5, h6, h, float(h @ turn @ h6), here[4]):
                q6 = _turn(-h6, _rotated(h5, -q5, h), turn.T @ h, here[5])
                plane = left * _about(h6, p[5], -q6) * _about(h5, p[4], -q5)
                for q2, q3 in self._triangle(p[3], plane.act(p[3]), here):
                    yield np.array([q1, q2, q3, _angle(h, plane.rotation) - q2 - q3, q5, q6])


def _meeting(axes: Array, points: Array) -> Array | None:
    """Return the common point of axes, shape (3,) [m]; None for parallel or passing axes."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    whole = across.sum(axis=0)
    if np.linalg.norm(np.cross(axes[:-1], axes[1:]), axis=1).min() < _PARALLEL:
        return None
    centre = np.linalg.solve(whole, (across @ points[:, :, None]).sum(axis=0)[:, 0])
    off = np.linalg.norm((across @ (centre - points)[:, :, None])[:, :, 0], axis=1)
    return centre if off.max() < _MEETING_M else None


def _turn(axis: Array, start: Array, end: Array, free: float) -> float:
    """Return the angle about an axis from one vector to another [rad]; ``free`` where one is along the axis."""
    cosine, sine = float(start @ end - (axis @ start) * (axis @ end)), float(axis @ np.cross(start, end))
    return free if np.hypot(cosine, sine) < _FREE else float(np.arctan2(sine, cosine))


def _turns(axis: Array, vector: Array, along: Array, part: float, free: float) -> tuple[float, ...]:
    """Return the angles about an axis at which a vector has a part along another [rad]; ``free`` where all have."""
    even = float((along @ axis) * (axis @ vector))
    cosine, sine = float(along @ vector) - even, float(along @ np.cross(axis, vector))
    if (size := float(np.hypot(cosine, sine))) < _FREE:
        return (free,) if abs(part - even) < _FREE else ()
    if (share := (part - even) / size) ** 2 > (1.0 + _STRETCHED) ** 2:
        return ()
    middle, half = float(np.arctan2(sine, cosine)), float(np.arccos(np.clip(share, -1.0, 1.0)))
    return (middle + half, middle - half) if half > 0.0 else (middle,)


def _angle(axis: Array, rotation: Array) -> float:
    """Return the angle of a rotation about a known axis [rad]."""
    sine = axis @ [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    return float(np.arctan2(sine, np.trace(rotation) - 1.0))


def _rotated(axis: Array, angle: float, vector: Array) -> Array:
    return np.asarray(pin.exp3(angle * axis) @ vector)


def _about(axis: Array, point: Array, angle: float) -> pin.SE3:
    """Return a turn about an axis through a point."""
    rotation = pin.exp3(angle * axis)
    return pin.SE3(rotation, point - rotation @ point)
