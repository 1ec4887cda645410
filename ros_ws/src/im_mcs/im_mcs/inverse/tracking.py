"""Joint positions of an arm along a path of the wrist, with the derivatives by the path parameter."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_mcs.inverse.arm import Arm
from im_mcs.model import CellModel, jacobian_of

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

    With fewer than six joints the wrist is where the pose is, turned about the axes that the arm gives up.
    """

    def __init__(self, model: CellModel, arm: Arm, frame: str) -> None:
        self._pin = model.pin
        self._data = model.pin.createData()
        self._frame = model.frame_id(frame)
        self._arm = arm
        self._rest = np.zeros(model.n)
        self._scale = np.array([1.0 / arm.reach] * 3 + [1.0] * (len(arm.joints) - 3))[:, None]

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
        turn, kept = target.rotation @ pose.rotation.T, (pose.rotation @ self._arm.kept).T
        if len(kept) < 2:
            rest = sum((_angle(turn, axis) * axis for axis in kept), np.zeros(3))
        elif len(kept) == 2:
            axis = np.cross(*kept)
            rest = pin.log3(turn @ pin.exp3(-_angle(turn, axis) * axis))
        else:
            rest = pin.log3(turn)
        return np.concatenate([target.translation - pose.translation, rest])

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
                rows = self._rows(target.rotation)
                step = np.linalg.solve(rows @ self._jacobian(q)[:, joints], rows @ error)
            except np.linalg.LinAlgError:
                return None
            if np.abs(step).max() > _LARGEST_STEP:
                return None
            q[joints] += step
        return None

    def derivatives(
        self,
        q: NDArray[np.float64],
        dq: NDArray[np.float64],
        ddq: NDArray[np.float64],
        target: pin.SE3,
        twist: NDArray[np.float64],
        twist_rate: NDArray[np.float64],
    ) -> Tracked | None:
        """Return a motion along a path of the wrist; None where the arm is exactly singular.

        Args:
            q: Positions of all joints, shape (n,) [rad or m].
            dq: Derivatives by the path parameter, shape (n,); those of the arm are overwritten.
            ddq: Second derivatives, likewise.
            target: Pose of the path in ``world``, which the wrist has but for the turns that are given up.
            twist: Derivative of the pose along the axes of ``world``, shape (6,): linear, angular.
            twist_rate: Its derivative, shape (6,).
        """
        joints = self._arm.joints
        jacobian = self._jacobian(q)
        rows = self._rows(target.rotation)
        arm = rows @ jacobian[:, joints]
        dq, ddq = dq.copy(), ddq.copy()
        dq[joints] = ddq[joints] = 0.0
        try:
            dq[joints] = np.linalg.solve(arm, rows @ (twist - jacobian @ dq))
            pin.forwardKinematics(self._pin, self._data, q, dq, self._rest)
            bias = pin.getFrameClassicalAcceleration(
                self._pin, self._data, self._frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            ).vector
            wanted = rows @ (twist_rate - bias - jacobian @ ddq)
            wanted[3:] += self._leaning(target.rotation, jacobian[3:] @ dq, twist[3:])
            ddq[joints] = np.linalg.solve(arm, wanted)
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
            jacobian = self._jacobian(q)[:, self._arm.joints]
            rows = self._rows(self._rotation())
            v[self._arm.joints] = np.linalg.solve(rows @ jacobian, rows @ twist)
        except np.linalg.LinAlgError:
            return None
        return v

    def singular_value(self, q: NDArray[np.float64]) -> float:
        """Smallest singular value of the arm's Jacobian at ``q``, shape (n,); lengths divided by the reach."""
        jacobian = self._jacobian(q)[:, self._arm.joints]
        return self._smallest(self._rows(self._rotation()) @ jacobian)

    def _rows(self, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the map from twists to their kept parts at the present pose, shape (n, 6)."""
        rotation = self._rotation()
        return self._arm.rows(rotation @ self._arm.kept_apart(_half_tangents(rotation.T @ target)))

    def _leaning(
        self, target: NDArray[np.float64], turning: NDArray[np.float64], wanted: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the part of second derivatives from the motion of the kept axes, shape (n - 3,).

        They turn with the frame, and where one turn is kept, lean towards the target.
        """
        if (count := self._arm.kept.shape[1]) == 3:
            return np.zeros(3)
        rotation = self._rotation()
        apart, away = _half_tangents(rotation.T @ target), rotation.T @ (wanted - turning)
        axes = rotation @ self._arm.kept_apart(apart)
        moved = np.cross(turning, axes.T)
        if count == 1:
            rate = 0.5 * (away + np.cross(away, apart) + apart * (away @ apart))
            moved += np.cross(rate, self._arm.kept.T) @ rotation.T
        return np.asarray(moved @ (wanted - turning))

    def _rotation(self) -> NDArray[np.float64]:
        """Rotation of the wrist where the Jacobian was computed last, shape (3, 3)."""
        return np.asarray(self._data.oMf[self._frame].rotation)

    def _smallest(self, jacobian: NDArray[np.float64]) -> float:
        return float(np.linalg.svd(jacobian * self._scale, compute_uv=False)[-1])

    def _jacobian(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        return jacobian_of(self._pin, self._data, q, self._frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)


def _angle(turn: NDArray[np.float64], axis: NDArray[np.float64]) -> float:
    """Return the angle of a rotation about an axis [rad]: what is left is a rotation about an axis across."""
    about = pin.Quaternion(turn)
    return 2.0 * float(np.arctan2(about.vec() @ axis, about.w))


def _half_tangents(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the axis of a rotation times the tangent of half its angle, shape (3,)."""
    about = pin.Quaternion(turn)
    return np.asarray(about.vec() / (about.w or np.finfo(float).eps))
