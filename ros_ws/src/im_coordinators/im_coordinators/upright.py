"""Tool kept upright on a path: the tilt of an axis, and the projection of positions onto upright ones.

Source: D. Berenson, S.S. Srinivasa, D. Ferguson, J.J. Kuffner, "Manipulation planning on constraint manifolds",
ICRA 2009.
"""

import numpy as np
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
        self._model, self._frame = model, frame
        vertical = model.pose(q_all, frame).rotation[2]
        nearest = int(np.abs(vertical).argmax())
        self._axis = np.eye(3)[nearest] * np.sign(vertical[nearest])
        self.limit = limit - MARGIN_RAD

    def tilt(self, q_all: Array) -> float:
        """Return the angle between the axis and the vertical at ``q_all``, shape (n,) [rad]."""
        x, y, z = self._model.pose(q_all, self._frame).rotation @ self._axis
        return float(np.arctan2(np.hypot(x, y), z))

    def levers(self) -> Array:
        """Return the largest change of the tilt by unit motion of each joint, shape (n,) [1 or rad/m]."""
        below = self._model.joints_below(self._frame)
        turning = [rank in below and joint.kind != "prismatic" for rank, joint in enumerate(self._model.cell.joints)]
        return np.array(turning, dtype=np.float64)

    def project(self, q_all: Array, index: NDArray[np.intp], lower: Array, upper: Array) -> Array | None:
        """Return positions near ``q_all`` with the axis vertical; None where none are found.

        Args:
            q_all: Positions of all joints, shape (n,) [rad or m]; those not in ``index`` stay.
            index: Joints that move, shape (k,).
            lower: Their smallest positions, shape (k,) [rad or m].
            upper: Their largest positions, shape (k,) [rad or m].
        """
        whole = q_all.copy()
        whole[index] = q = np.clip(q_all[index], lower, upper)
        for _ in range(_STEPS):
            x, y, z = self._model.pose(whole, self._frame).rotation @ self._axis
            level = float(np.hypot(x, y))
            if (tilt := float(np.arctan2(level, z))) < EXACT_RAD:
                return q
            turn = np.array([y, -x, 0.0]) / max(level, 1e-9)
            jacobian = self._model.jacobian(whole, self._frame)[3:, index]
            for _ in range(2):  # joints at their limits stay
                inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + _DAMPING * np.eye(3))
                step = inverse @ turn * min(tilt, _LONGEST_RAD)
                outside = (q + step < lower) | (q + step > upper)
                jacobian = jacobian * ~outside
            whole[index] = q = np.clip(q + step, lower, upper)
        return None
