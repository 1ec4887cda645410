"""Two-mirror laser scanner: from mirror angles to a ray in the world, and back.

The beam comes along the scanner's x axis, is thrown by mirror 1 towards mirror 2, which turns about the x axis, and
leaves along z when both angles are zero. A mirror that turns by an angle turns the beam by twice as much. Mirror 1
therefore sweeps a plane that contains the x axis, whatever its angle; mirror 2 alone sweeps a cone. Source: G. F.
Marshall, G. E. Stutz, "Handbook of Optical and Laser Scanning", 2nd ed., 2012, chapter on galvanometers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from im_core.errors import DataError

Array = NDArray[np.float64]

_ROUNDS = 2.0
"""Turn of the beam by turn of the mirror."""


@dataclass(frozen=True)
class LaserModel:
    """Pose and mirrors of a laser scanner.

    Attributes:
        rotation: Rotation scanner -> world, shape (3, 3).
        position: Centre of mirror 2 in the world, shape (3,) [m].
        gap: Distance of the mirrors [m].
        gain: True angle of each mirror by the one it reports, shape (2,) [-].
        offset: Angle of mirror 1 when it reports zero [rad]; that of mirror 2 is a turn of the whole scanner.

    >>> laser = LaserModel(rotation=down, position=height, gap=0.01)
    >>> laser.angles_to([0.0, -1.0, 2.0]).round(3).tolist()  # half the angle of the beam, 45 deg
    [0.0, 0.393]
    """

    rotation: Array
    position: Array
    gap: float
    gain: tuple[float, float] = (1.0, 1.0)
    offset: float = 0.0

    def rays(self, angles: ArrayLike) -> tuple[Array, Array]:
        """Compute origins of beams on mirror 2, and directions of the beams.

        Args:
            angles: Angles the mirrors report, shape (..., 2) [rad].

        Returns:
            Origins, shape (..., 3) [m], and unit directions, shape (..., 3), in the world.
        """
        alpha, beta = self._deflections(np.asarray(angles, dtype=float))
        zero = np.zeros_like(alpha)
        origin = np.stack((self.gap * np.tan(alpha), zero, zero), axis=-1)
        direction = np.stack((np.sin(alpha), np.cos(alpha) * np.sin(beta), np.cos(alpha) * np.cos(beta)), axis=-1)
        return origin @ self.rotation.T + self.position, direction @ self.rotation.T

    def planes(self, mirror2: ArrayLike) -> Array:
        """Compute normals of the planes swept by mirror 1; all planes contain :attr:`position`.

        Args:
            mirror2: Angles of mirror 2, shape (...) [rad].

        Returns:
            Unit normals in the world, shape (..., 3).
        """
        beta = _ROUNDS * self.gain[1] * np.asarray(mirror2, dtype=float)
        normal = np.stack((np.zeros_like(beta), np.cos(beta), -np.sin(beta)), axis=-1)
        return np.asarray(normal @ self.rotation.T)

    def angles_to(self, target: ArrayLike) -> Array:
        """Compute the mirror angles to be reported for the beam to meet a point.

        Args:
            target: Points in the world, shape (..., 3) [m].

        Returns:
            Angles, shape (..., 2) [rad].

        Raises:
            DataError: A point is not finite, or behind the scanner.
        """
        places = np.asarray(target, dtype=float)
        if not np.all(np.isfinite(places)):
            raise DataError("a target of the laser is not finite")
        point = (places - self.position) @ self.rotation
        if np.any(point[..., 2] <= 0.0):
            raise DataError(f"the target is behind the laser scanner, by {-float(point[..., 2].min()):.3f} m")
        alpha = np.arctan2(point[..., 0], self.gap + np.hypot(point[..., 1], point[..., 2]))
        beta = np.arctan2(point[..., 1], point[..., 2])
        mirrors = np.stack((alpha / _ROUNDS - self.offset, beta / _ROUNDS), axis=-1)
        return np.asarray(mirrors / np.array(self.gain))

    def _deflections(self, angles: Array) -> tuple[Array, Array]:
        first = _ROUNDS * (self.gain[0] * angles[..., 0] + self.offset)
        return np.asarray(first), np.asarray(_ROUNDS * self.gain[1] * angles[..., 1])
