"""Poses in the world, as numpy arrays."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as PoseMessage
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of a wrist frame in the world (REP-103).

    Attributes:
        position: Shape (3,) [m].
        quaternion: Orientation x, y, z, w, shape (4,); None, as a goal: the present orientation.
    """

    position: NDArray[np.float64]
    quaternion: NDArray[np.float64] | None

    def __init__(self, position: Sequence[float], quaternion: Sequence[float] | None = None) -> None:
        """Check the numbers.

        Raises:
            ValueError: A number is missing or not finite, or the quaternion has no length of 1.
        """
        object.__setattr__(self, "position", _vector("position", position, 3))
        turned = None if quaternion is None else _vector("quaternion", quaternion, 4)
        if turned is not None and abs(np.linalg.norm(turned) - 1.0) > 1e-3:
            raise ValueError(f"quaternion {turned.tolist()} has the length {np.linalg.norm(turned):g}, not 1")
        object.__setattr__(self, "quaternion", turned)

    @classmethod
    def of(cls, message: PoseMessage) -> "Pose":
        """Return the pose of a message."""
        p, q = message.position, message.orientation
        return cls((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))

    def message(self, present: "Pose") -> PoseMessage:
        """Return the message; without an orientation, with the one of the present pose."""
        turned = present.quaternion if self.quaternion is None else self.quaternion
        x, y, z, w = (0.0, 0.0, 0.0, 1.0) if turned is None else turned.tolist()
        px, py, pz = self.position.tolist()
        return PoseMessage(position=Point(x=px, y=py, z=pz), orientation=Quaternion(x=x, y=y, z=z, w=w))


def require_pose(name: str, given: object) -> None:
    """Refuse numbers in place of a pose.

    Raises:
        TypeError: It is no pose.
    """
    if not isinstance(given, Pose):
        raise TypeError(f"{name} is {given!r}; a Pose is needed, such as Pose([0.3, 0.0, 1.0])")


def _vector(name: str, values: Sequence[float], length: int) -> NDArray[np.float64]:
    with contextlib.suppress(TypeError, ValueError):
        vector = np.asarray(values, dtype=float)
        if vector.shape == (length,) and np.isfinite(vector).all():
            return vector
    raise ValueError(f"{name} {values!r} is no vector of {length} finite numbers")
