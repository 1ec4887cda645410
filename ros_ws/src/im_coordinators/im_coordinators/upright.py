"""Tool kept upright on a path: the tilt of its axis, and positions projected onto the upright ones.

Source: D. Berenson, S.S. Srinivasa, D. Ferguson, J.J. Kuffner, "Manipulation planning on constraint manifolds",
ICRA 2009.
"""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_mcs.model import CellModel

Array = NDArray[np.float64]

#: A path keeps this much below the limit [rad]: an arm follows its path with some error.
MARGIN_RAD = 2e-3
#: Projections end at this tilt [rad], or after so many steps, none of them longer than this [rad].
EXACT_RAD = 1e-3
_STEPS, _LONGEST_RAD = 30, 0.5
_DAMPING = 1e-4


class Upright:
    """Limit of the tilt of a tool's axis: of x, y and z of the wrist, either way, the one nearest to the vertical.

    Args:
        model: Kinematics.
        frame: The wrist.
        limit: Largest tilt [rad].
        q_all: Positions of all joints where the path begins, shape (n,) [rad or m].

    Attributes:
        limit: Largest tilt of a path [rad].
    """

    def __init__(self, model: CellModel, frame: str, limit: float, q_all: Array) -> None:
        self._model, self._data, self._frame = model, model.pin.createData(), model.frame_id(frame)
        self._axis = np.array([0.0, 0.0, 1.0])
        vertical = self._rotation(q_all)[2]
        nearest = int(np.abs(vertical).argmax())
        self._axis = np.eye(3)[nearest] * np.sign(vertical[nearest])
        self.limit = limit - MARGIN_RAD

    def tilt(self, q_all: Array) -> float:
        """Return the angle between the axis and the vertical at ``q_all``, shape (n,) [rad]."""
        x, y, z = self._rotation(q_all) @ self._axis
        return float(np.arctan2(np.hypot(x, y), z))

    def levers(self) -> Array:
        """Return the largest change of the tilt by unit motion of each joint, shape (n,) [1 or rad/m]."""
        below = self._model.joints_below(self._model.pin.frames[self._frame].name)
        turning = [rank in below and joint.kind == "revolute" for rank, joint in enumerate(self._model.cell.joints)]
        return np.array(turning, dtype=np.float64)

    def project(self, q_all: Array, index: NDArray[np.intp], lower: Array, upper: Array) -> Array | None:
        """Return positions near those of some joints with the axis vertical; None where none are found.

        Args:
            q_all: Positions of all joints, shape (n,) [rad or m].
            index: Joints that may move, shape (k,).
            lower: Their smallest positions, shape (k,) [rad or m].
            upper: Their largest positions, shape (k,) [rad or m].
        """
        whole = q_all.copy()
        whole[index] = q = np.clip(q_all[index], lower, upper)
        for _ in range(_STEPS):
            axis = self._rotation(whole) @ self._axis
            tilt = np.arctan2(np.hypot(*axis[:2]), axis[2])
            if tilt < EXACT_RAD:
                return q
            turn = np.array([axis[1], -axis[0], 0.0]) / max(float(np.hypot(*axis[:2])), 1e-9)
            jacobian = self._jacobian(whole)[:, index]
            for _ in range(2):  # joints at their limits stay
                inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + _DAMPING * np.eye(3))
                step = inverse @ turn * min(tilt, _LONGEST_RAD)
                outside = (q + step < lower) | (q + step > upper)
                jacobian = jacobian * ~outside
            whole[index] = q = np.clip(q + step, lower, upper)
        return None

    def _rotation(self, q_all: Array) -> Array:
        pin.forwardKinematics(self._model.pin, self._data, q_all)
        return np.asarray(pin.updateFramePlacement(self._model.pin, self._data, self._frame).rotation)

    def _jacobian(self, q_all: Array) -> Array:
        """Return the angular velocity of the wrist in ``world`` for each joint's, shape (3, n)."""
        reference = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return np.asarray(pin.computeFrameJacobian(self._model.pin, self._data, q_all, self._frame, reference)[3:])
