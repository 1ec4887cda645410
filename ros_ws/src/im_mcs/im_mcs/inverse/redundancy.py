"""Use of joints left free by a pose of the wrist."""

import numpy as np
from numpy.typing import NDArray

from im_mcs.inverse.arm import ARM_JOINTS, Arm
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

# Share of its range within which a joint is pushed off a limit, and how hard: more than towards the preferred place.
_ZONE = 0.12
_LIMIT_GAIN = 6.0
# Size that the arm's singularity factors should have, and how hard they are brought there.
_FACTOR = 0.4
_FACTOR_GAIN = 4.0


class Redundancy:
    """Preferred region of a group: near the preferred position, off joint limits and singularities of the arm.

    The wish is the negative gradient of a sum of squares, to be followed in the null space of the task (A. Liegeois,
    1977).

    Args:
        model: Kinematics.
        limits: Ranges of the joints.
        index: Joints of the group, shape (n,).
        frame: Its wrist frame.
        preferred: Positions of the group, shape (n,) [rad or m].
    """

    def __init__(
        self,
        model: CellModel,
        limits: JointLimits,
        index: NDArray[np.intp],
        frame: str,
        preferred: NDArray[np.float64],
    ) -> None:
        self._preferred = preferred
        zone = _ZONE * (limits.upper - limits.lower)[index]
        self._low, self._high = limits.lower[index] + zone, limits.upper[index] - zone
        ranks = {int(joint): rank for rank, joint in enumerate(index)}
        self._arm: Arm | None = None
        if len(model.joints_below(frame)) >= ARM_JOINTS:  # shorter chains have no joint to spare
            arm = Arm(model, frame)
            self._arm = arm if all(int(joint) in ranks for joint in arm.joints) else None
            self._ranks = np.array([ranks.get(int(joint), 0) for joint in arm.joints], dtype=np.intp)

    def wish(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the wanted displacement of the group, shape (n,) [rad or m].

        Args:
            q: Positions of the group, shape (n,) [rad or m].
        """
        wish = self._preferred - q
        wish += _LIMIT_GAIN * (np.maximum(self._low - q, 0.0) - np.maximum(q - self._high, 0.0))
        if self._arm is not None:
            wish[self._ranks] += _FACTOR_GAIN * self._arm.away(q[self._ranks], _FACTOR)
        return wish
