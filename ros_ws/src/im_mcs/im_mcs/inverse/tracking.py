"""Joint positions of an arm along a path of the wrist, with the derivatives by the path parameter."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_mcs.inverse.arm import Arm
from im_mcs.model import CellModel

_ITERATIONS = 8
_PRECISION = 1e-11
_LARGEST_STEP = 0.5


@dataclass(frozen=True)
class Tracked:
    """Motion of all joints at one place of a path; derivatives are by the path parameter.

    Attributes:
        q: Positions, shape (n,) [rad or m].
        dq: First derivative, shape (n,).
        ddq: Second derivative, shape (n,).
        singular_value: Smallest of the arm's Jacobian, lengths divided by its reach.
        factors: Of the arm's singularities.
    """

    q: NDArray[np.float64]
    dq: NDArray[np.float64]
    ddq: NDArray[np.float64]
    singular_value: float
    factors: tuple[float, ...]


class ArmTracker:
    """Newton's method for the joints of an arm at a pose of the wrist, near to the present positions.

    With five joints the wrist is where the pose is, turned about the axis that the arm gives up.
    """

    def __init__(self, model: CellModel, arm: Arm, frame: str) -> None:
        self._pin = model.pin
        self._data = model.pin.createData()
        self._frame = model.frame_id(frame)
        self._arm = arm
        self._rest = np.zeros(model.n)
        self._scale = np.array([1.0 / arm.reach] * 3 + [1.0] * 3)[:, None]

    def pose(self, q: NDArray[np.float64]) -> pin.SE3:
        """Pose of the wrist in ``world`` at ``q``, shape (n,)."""
        pin.forwardKinematics(self._pin, self._data, q)
        return pin.updateFramePlacement(self._pin, self._data, self._frame).copy()

    def moved(
        self, q: NDArray[np.float64], dq: NDArray[np.float64], ddq: NDArray[np.float64]
    ) -> tuple[pin.SE3, NDArray[np.float64], NDArray[np.float64]]:
        """Return pose, twist and derivative of the twist of the wrist for a motion of the joints.

        Args:
            q: Positions of all joints, shape (n,) [rad or m].
            dq: Derivatives by the path parameter, shape (n,).
            ddq: Second derivatives, shape (n,).

        Returns:
            The pose in ``world``, and shape (6,) twice, along its axes: linear, angular.
        """
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pin.forwardKinematics(self._pin, self._data, q, dq, ddq)
        pose = pin.updateFramePlacement(self._pin, self._data, self._frame).copy()
        twist = pin.getFrameVelocity(self._pin, self._data, self._frame, axes).vector
        return pose, twist, pin.getFrameClassicalAcceleration(self._pin, self._data, self._frame, axes).vector

    def error(self, target: pin.SE3, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Way from the wrist at ``q`` to a pose, shape (6,): linear [m], angular [rad], without turns given up."""
        pin.forwardKinematics(self._pin, self._data, q)
        pose = pin.updateFramePlacement(self._pin, self._data, self._frame)
        turn = target.rotation @ pose.rotation.T
        for axis in (pose.rotation @ self._arm.given_up).T:
            about = pin.Quaternion(turn)
            turn = turn @ pin.exp3(-2.0 * np.arctan2(about.vec() @ axis, about.w) * axis)
        return np.concatenate([target.translation - pose.translation, pin.log3(turn)])

    def solve(self, target: pin.SE3, guess: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return all joint positions to reach a pose, only the arm's changed from ``guess``; None if none is near.

        Args:
            target: Wanted pose of the wrist in ``world``.
            guess: Shape (n,) [rad or m].
        """
        q, joints = guess.copy(), self._arm.joints
        for _ in range(_ITERATIONS):
            error = self.error(target, q)
            if np.abs(error).max() < _PRECISION:
                return q
            try:
                step = np.linalg.solve(self._square(q), error)
            except np.linalg.LinAlgError:
                return None
            if np.abs(step).max() > _LARGEST_STEP:
                return None
            q[joints] += step[: len(joints)]
        return None

    def derivatives(
        self,
        q: NDArray[np.float64],
        dq: NDArray[np.float64],
        ddq: NDArray[np.float64],
        twist: NDArray[np.float64],
        twist_rate: NDArray[np.float64],
    ) -> Tracked | None:
        """Return a motion along a path of the wrist; None where the arm is exactly singular.

        Args:
            q: Positions of all joints, shape (n,) [rad or m].
            dq: Derivatives by the path parameter, shape (n,); those of the arm are overwritten.
            ddq: Second derivatives, likewise.
            twist: Derivative of the wrist's pose along the axes of ``world``, shape (6,): linear, angular.
            twist_rate: Its derivative, shape (6,).
        """
        joints = self._arm.joints
        jacobian = self._jacobian(q)
        turn = self._rotation()
        arm = self._arm.square(jacobian, turn)
        dq, ddq = dq.copy(), ddq.copy()
        dq[joints] = ddq[joints] = 0.0
        try:
            first = np.linalg.solve(arm, twist - jacobian @ dq)
            dq[joints] = first[: len(joints)]
            pin.forwardKinematics(self._pin, self._data, q, dq, self._rest)
            bias = pin.getFrameClassicalAcceleration(
                self._pin, self._data, self._frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            ).vector
            for axis, rate in zip((turn @ self._arm.given_up).T, first[len(joints) :], strict=True):
                bias[3:] += rate * np.cross(jacobian[3:] @ dq, axis)
            ddq[joints] = np.linalg.solve(arm, twist_rate - bias - jacobian @ ddq)[: len(joints)]
        except np.linalg.LinAlgError:
            return None
        return Tracked(q, dq, ddq, self._smallest(arm), self._arm.factors(q[joints]))

    def velocities(self, q: NDArray[np.float64], twist: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return joint velocities, shape (n,), that move the wrist; None where the arm is exactly singular.

        Args:
            q: Positions of all joints, shape (n,) [rad or m].
            twist: Velocity of the wrist along the axes of ``world``, shape (6,): linear, angular.
        """
        v = np.zeros_like(q)
        self._arm.give_up(q)
        try:
            v[self._arm.joints] = np.linalg.solve(self._square(q), twist)[: len(self._arm.joints)]
        except np.linalg.LinAlgError:
            return None
        return v

    def singular_value(self, q: NDArray[np.float64]) -> float:
        """Smallest singular value of the arm's Jacobian at ``q``, shape (n,); lengths divided by the reach."""
        return self._smallest(self._square(q))

    def _square(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        jacobian = self._jacobian(q)
        return self._arm.square(jacobian, self._rotation())

    def _rotation(self) -> NDArray[np.float64]:
        """Rotation of the wrist where the Jacobian was computed last, shape (3, 3)."""
        return np.asarray(self._data.oMf[self._frame].rotation)

    def _smallest(self, jacobian: NDArray[np.float64]) -> float:
        return float(np.linalg.svd(jacobian * self._scale, compute_uv=False)[-1])

    def _jacobian(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(
            pin.computeFrameJacobian(self._pin, self._data, q, self._frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        )
