"""Kinematic questions without the servo; safe to ask from several threads."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.robot import Group
from im_core.errors import DataError, NotFoundError, StateError
from im_mcs.client.points import check_measured_path
from im_mcs.collision import NOTHING, CollisionChecker, CollisionScene
from im_mcs.inverse import InverseKinematics
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.planning.motions.joint import JointPath
from im_mcs.protocol.requests import unit_pose


@dataclass(frozen=True)
class Forward:
    """Place of a frame, and the Jacobian by the joints of a group.

    Attributes:
        pose: Of the frame in ``world``.
        jacobian: Velocity of its origin along the axes of ``world``, shape (6, n): linear, angular.
    """

    pose: pin.SE3
    jacobian: NDArray[np.float64]


class Kinematics:
    """Forward and inverse kinematics and path checks for the groups of a configuration.

    Args:
        config: Configuration.
        model: Kinematics and shapes; used by this object alone.
    """

    def __init__(self, config: McsConfig, model: CellModel) -> None:
        self._config = config
        self._model = model
        self._limits = JointLimits(model.cell, config.limits, config.slots)
        self._lock = threading.Lock()
        self._paths_lock = threading.Lock()
        self.surround(NOTHING)

    def surround(self, around: CollisionScene) -> None:
        """Keep away from other free bodies, and let other pairs touch, from the next question on."""
        clearance_m = self._config.collision.clearance_m
        of_poses, of_paths = (CollisionChecker(self._model, clearance_m, around) for _ in range(2))
        with self._lock:
            self._collision = of_poses
        with self._paths_lock:  # of their own: they may take long
            self._paths = of_paths

    def limits_of(self, group: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the smallest and largest positions of a group's joints, shape (n,) each [rad or m].

        Raises:
            NotFoundError: No such group.
        """
        index = self.index(group)
        return self._limits.lower[index], self._limits.upper[index]

    def forward(self, group: str, q: Sequence[float], q_all: NDArray[np.float64], frame: str = "") -> Forward:
        """Pose of a frame with the joints of a group at ``q``, and the group's Jacobian.

        Args:
            group: Name of the group.
            q: Positions of its joints, shape (n,), beyond their limits too; empty: where the group is.
            q_all: Positions of all joints, shape (n,) [rad or m].
            frame: Link or frame; empty: the group's wrist.

        Raises:
            NotFoundError: No such group or frame.
            StateError: The group has no wrist, and no frame was named.
            DataError: Wrong number of positions, or one is not finite.
        """
        name = frame or self._wrist(group)
        index, whole = self.index(group), q_all.copy()
        if len(q):
            whole[index] = self._limits.check_finite(index, q, "q")
        with self._lock:
            return Forward(self._model.pose(whole, name), self._model.jacobian(whole, name)[:, index].copy())

    def inverse(
        self,
        group: str,
        position: Sequence[float],
        orientation: Sequence[float],
        seed: Sequence[float],
        q_all: NDArray[np.float64],
        avoid_collisions: bool,
    ) -> NDArray[np.float64]:
        """Return joint positions of a group for a pose of the wrist.

        Args:
            group: Name of the group.
            position: Of the wrist in ``world``, shape (3,) [m].
            orientation: Quaternion x, y, z, w.
            seed: Where to start, shape (n,); empty: where the group is.
            q_all: Positions of all joints, shape (n,) [rad or m].
            avoid_collisions: Whether solutions in collision are passed over.

        Raises:
            NotFoundError: No such group.
            StateError: The group has no wrist.
            DataError: A value is not finite, or the pose is out of reach.
            LimitError: The seed is out of range.
            ImError: Every solution is in collision.
        """
        wrist = self._wrist(group)
        target = wrist_pose(position, orientation)
        index = self.index(group)
        start = self._limits.check_positions(index, seed, "seed") if len(seed) else q_all[index]
        with self._lock:
            solver = InverseKinematics(self._model, self._limits, index, wrist)
            return solver.solve(target, q_all, start, self._collision if avoid_collisions else None)

    def check_path(
        self, group: str, points: list[list[float]], q_all: NDArray[np.float64], blend: float = 0.0
    ) -> float:
        """Return the smallest distance on a move through ``points`` [m], by the move's own planner.

        Args:
            group: Name of the group.
            points: Of the path, as positions of the group's joints; the first, at rest, is where the move begins.
            q_all: Positions of all joints, shape (n,) [rad or m].
            blend: Of the move: how far from a point its corner may begin [rad or m]; 0: rest in each point.

        Raises:
            NotFoundError: No such group.
            DataError: A value is not finite, sizes are wrong, or ``blend`` is not >= 0.
            LimitError: A point is out of range.
            ImError: Two bodies come too close (code ``collision``).
        """
        self._group(group)
        if not blend >= 0.0:
            raise DataError(f"blend {blend:g} is not >= 0", value=blend)
        index = self.index(group)
        path = check_measured_path(self._limits, index, points, self._config.planning.max_points)
        limits = self._limits.motion.of(index)
        motion = JointPath(path[0], path[1:], limits, self._config.planning.synchrony, blend)
        with self._paths_lock:
            return self._paths.check_motion(q_all, index, motion, limits.velocity)

    def index(self, group: str) -> NDArray[np.intp]:
        """Return ranks of a group's joints, shape (n,).

        Raises:
            NotFoundError: No such group.
        """
        return np.array([self._model.index(joint) for joint in self._group(group).joints], dtype=np.intp)

    def _wrist(self, group: str) -> str:
        wrist = self._group(group).wrist
        if wrist is None:
            raise StateError(f"group '{group}' has no wrist; poses are those of a wrist", group=group)
        return wrist

    def _group(self, name: str) -> Group:
        groups = self._config.groups
        if name not in groups:
            raise NotFoundError(kind="group", name=name, known=groups)
        return groups[name]


def wrist_pose(position: Sequence[float], orientation: Sequence[float]) -> pin.SE3:
    """Return a pose from a position [m] and a quaternion x, y, z, w.

    Raises:
        DataError: A value is not finite, or the quaternion is not of length 1 (within 1 %).
    """
    try:
        return pin.XYZQUATToSE3(np.array(unit_pose([*position, *orientation])))
    except ValueError as error:
        raise DataError(str(error)) from None
