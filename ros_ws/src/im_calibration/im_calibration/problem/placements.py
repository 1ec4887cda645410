"""Targets at unknown places, and intrinsics known beforehand."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.problem.arm_error import ArmError
from im_cell.rotations import cross_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GivenIntrinsics:
    """Intrinsics of a camera from elsewhere.

    Attributes:
        values: fx, fy, cx, cy [px] and the lens coefficients that are estimated [-], shape (k,).
        precision: Inverse of their covariance, shape (k, k).
    """

    values: Array
    precision: Array


@dataclass(frozen=True)
class Placements:
    """Rigid targets with unknown places, the points among n positions.

    Position i is ``positions[i] + G_i (Q q_i + s - q_i)``, with Q and s the turn and shift of its target, and q_i the
    point where the positions have it, in a frame in which the target is at rest.

    Attributes:
        of: Which target each position is of, -1: of none, shape (n,).
        rotations: Rotations G from the frame of the target's rest to the world, shape (n, 3, 3).
        points: Points q, shape (n, 3) [m].
        places: Places of the targets by the positions, in their frames of rest, shape (m, 4, 4) [-], [m].
        arm: Largest smooth error of the readings of a robot of which the kinematics are not given; None: there is none.
        roots: Derivatives of the positions by six errors of unit variance of a reading of the robot, shape (n, 3, 6)
            [m]; None: no robot.
        held: Where the first camera is, whose axes are the world's, shape (3,) [m]; None: the robot's frame is the
            world's.
        camera_moves: Whether the robot's frame is that of the link with the cameras; if not, it is the base.
    """

    of: NDArray[np.intp]
    rotations: Array
    points: Array
    places: Array
    arm: ArmError | None = None
    roots: Array | None = None
    held: Array | None = None
    camera_moves: bool = False

    @property
    def count(self) -> int:
        """Number of targets."""
        return len(self.places)

    def displacements(self, placed: Array) -> Array:
        """Return the displacements of the positions, shape (n, 3) [m], by turns and shifts, shape (m, 3, 4)."""
        each = placed[self.of]
        moved = (each[:, :, :3] @ self.points[..., None])[..., 0] + each[:, :, 3] - self.points
        return np.asarray(np.where(self.of[:, None] < 0, 0.0, (self.rotations @ moved[..., None])[..., 0]))

    def jacobians(self, placed: Array) -> Array:
        """Return derivatives of the positions by a further turn and shift of each target, shape (n, 3, 6) [m]."""
        turned = placed[self.of, :, :3] @ self.points[..., None]
        return np.concatenate((-self.rotations @ cross_matrix(turned[..., 0]), self.rotations), axis=2)

    def with_noise(self, robot: float) -> "Placements":
        """Return the same with another factor on the errors of the robot."""
        return replace(self, roots=None if self.roots is None else robot * self.roots)

    def moved(self, by: Array) -> "Placements":
        """Return the same in a world with another origin."""
        return replace(self, held=None if self.held is None else self.held + by)

    def taking(self, poses: NDArray[np.intp]) -> "Placements":
        """Return the same of some positions."""
        roots = None if self.roots is None else self.roots[poses]
        arm = self.arm and self.arm.taking(poses)
        rotations, points = self.rotations[poses], self.points[poses]
        return replace(self, of=self.of[poses], rotations=rotations, points=points, arm=arm, roots=roots)
