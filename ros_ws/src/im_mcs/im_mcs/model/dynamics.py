"""Kinematics and dynamics of the cell in the eyes of MCS (pinocchio)."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.robot import Cell, urdf
from im_core.errors import NotFoundError

Place = slice | NDArray[np.intp]
"""Where the joints of a group are among all joints."""


class CellModel:
    """All joints of the cell, in the order; made from the same parameter file as the testbed.

    Args:
        cell: Parameters.
        error: Share by which masses and inertias, those of the rotors too, are made wrong; 0.1: 10 % too large.
    """

    def __init__(self, cell: Cell, error: float = 0.0) -> None:
        self.cell = cell
        self.names: tuple[str, ...] = cell.joint_names
        self.n = len(self.names)
        self.pin = pin.buildModelFromXML(urdf(cell, shapes=False))
        self.pin.gravity.linear = np.array([0.0, 0.0, -cell.gravity])
        self.rotor_inertia = cell.per_joint("rotor_inertia") * (1.0 + error)
        if error != 0.0:
            for body in self.pin.inertias:
                body.mass, body.inertia = body.mass * (1.0 + error), body.inertia * (1.0 + error)
        self.pin.armature = self.rotor_inertia
        self.viscous_friction = cell.per_joint("viscous")
        self.coulomb_positive = cell.per_joint("coulomb_positive")
        self.coulomb_negative = cell.per_joint("coulomb_negative")
        self._data = self.pin.createData()
        order = tuple(self.pin.names)[1:]
        if order != self.names:
            raise NotFoundError(kind="joint order", name=", ".join(order), known=self.names)

    def index(self, joint: str) -> int:
        """Rank of a joint.

        Raises:
            NotFoundError: There is no such joint.
        """
        if joint not in self.names:
            raise NotFoundError(kind="joint", name=joint, known=self.names)
        return self.names.index(joint)

    def frame_id(self, frame: str) -> int:
        """Identifier of a frame, for the other methods.

        Raises:
            NotFoundError: There is no such frame.
        """
        if self.pin.existFrame(frame, pin.FrameType.BODY):  # a joint may have the name of a link
            return int(self.pin.getFrameId(frame, pin.FrameType.BODY))
        if not self.pin.existFrame(frame):
            raise NotFoundError(kind="frame", name=frame, known=[f.name for f in self.pin.frames])
        return int(self.pin.getFrameId(frame))

    def joints_below(self, frame: str) -> NDArray[np.intp]:
        """Return ranks of the joints moving a frame with all the loads, shape (k,).

        Raises:
            NotFoundError: There is no such frame.
        """
        joint = self.pin.frames[self.frame_id(frame)].parentJoint
        return np.array([below - 1 for below in self.pin.supports[joint] if below > 0], dtype=np.intp)

    def gravity(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return torques for still arms at ``q``, shape (n,) [Nm or N]."""
        return np.asarray(pin.computeGeneralizedGravity(self.pin, self._data, q))

    def inertia(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joint-space inertia with rotors at ``q``, shape (n, n) [kg m2, kg m or kg]."""
        upper = np.triu(pin.crba(self.pin, self._data, q))
        return np.asarray(upper + np.triu(upper, 1).T)

    def inertia_diagonal(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Each joint's own inertia at ``q`` while the others stand still, shape (n,)."""
        return np.asarray(pin.crba(self.pin, self._data, q).diagonal().copy())

    def inverse_dynamics(
        self, q: NDArray[np.float64], v: NDArray[np.float64], a: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return torques of a motion, with rotors, without friction, shape (n,) [Nm or N]."""
        return np.asarray(pin.rnea(self.pin, self._data, q, v, a)).copy()

    def pose(self, q: NDArray[np.float64], frame: str) -> pin.SE3:
        """Pose of a frame in ``world`` at ``q``, shape (n,).

        Raises:
            NotFoundError: There is no such frame.
        """
        frame_id = self.frame_id(frame)
        pin.forwardKinematics(self.pin, self._data, q)
        return pin.updateFramePlacement(self.pin, self._data, frame_id).copy()

    def seen_from(self, q: NDArray[np.float64], frame: str, pose: Sequence[float], other: str) -> tuple[float, ...]:
        """Return a pose given in one frame, seen from another one at ``q``, shape (n,).

        Args:
            q: Positions of all joints, shape (n,) [rad or m].
            frame: ``world`` or a frame.
            pose: In it: position [m] and quaternion x, y, z, w, shape (7,).
            other: ``world`` or a frame.

        Raises:
            NotFoundError: There is no such frame.
        """
        own, seen = (pin.SE3.Identity() if name == "world" else self.pose(q, name) for name in (frame, other))
        there = own * pin.XYZQUATToSE3(np.array(pose, dtype=np.float64))
        return tuple(pin.SE3ToXYZQUAT(seen.actInv(there)).tolist())

    def poses(self, q: NDArray[np.float64]) -> dict[str, pin.SE3]:
        """Pose of every body and frame in ``world`` at ``q``."""
        pin.framesForwardKinematics(self.pin, self._data, q)
        return {
            frame.name: self._data.oMf[i] for i, frame in enumerate(self.pin.frames) if frame.type == pin.FrameType.BODY
        }

    def jacobian(self, q: NDArray[np.float64], frame: str) -> NDArray[np.float64]:
        """Velocity of a frame's origin for each joint's, along the axes of ``world``, shape (6, n): linear, angular.

        Raises:
            NotFoundError: There is no such frame.
        """
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return jacobian_of(self.pin, self._data, q, self.frame_id(frame), axes)


def jacobian_of(
    model: pin.Model, data: pin.Data, q: NDArray[np.float64], frame: int, axes: pin.ReferenceFrame
) -> NDArray[np.float64]:
    """Return the velocity of a frame's origin for each joint's, shape (6, n); of one joint pinocchio makes a vector.

    Args:
        model: The arms.
        data: Memory of pinocchio for them.
        q: Positions of all joints, shape (n,) [rad or m].
        frame: Identifier.
        axes: Along which the velocity is.
    """
    return np.asarray(pin.computeFrameJacobian(model, data, q, frame, axes)).reshape(6, -1)


def place_of(index: NDArray[np.intp]) -> Place:
    """Return ranks of joints, shape (n,), as a slice for neighbours: numpy writes there several times quicker."""
    first, count = int(index[0]), len(index)
    return slice(first, first + count) if np.array_equal(index, np.arange(first, first + count)) else index
