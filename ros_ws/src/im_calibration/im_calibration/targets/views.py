"""Views of a target by cameras, with the poses of a robot."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ShownViews = Mapping[str, tuple[str, NDArray[np.uint8] | NDArray[np.uint16]]]
"""Of each camera, the name of a view of the target, and the grey image."""


@dataclass(frozen=True)
class RobotPoses:
    """Poses read from a robot, one a view, with the errors of a reading.

    Attributes:
        poses: Wrist (or any other link) in the base, shape (k, 4, 4) [-], [m].
        camera_moves: Whether the cameras are on the wrist and the target is at rest; if not, it is the other way round.
        sd_m: Standard deviation of each coordinate of the place [m].
        sd_rad: Standard deviation of the turn about each axis [rad].
        covariances: In place of these, covariances of each reading, places before turns, axes of the base, shape
            (k, 6, 6) [m^2], [m rad], [rad^2]; None: these hold.
        arm: Derivatives of each reading, likewise, by the errors of the arm's kinematics, each of its usual size, shape
            (k, 6, m) [m], [rad]; None: the kinematics are not known.
    """

    poses: Array
    camera_moves: bool
    sd_m: float
    sd_rad: float
    covariances: Array | None = None
    arm: Array | None = None


@dataclass(frozen=True)
class TargetViews:
    """Views of one target by c cameras.

    Attributes:
        target: Name of the target, for people.
        points: Points of the target, shape (p, 3) [m].
        camera_names: Names of the cameras.
        image_sizes: Width and height of each camera's image [px].
        lens_models: Lens model of each camera.
        names: Names of the k views.
        spots: The points in the images, NaN where not seen, shape (c, k, p, 2) [px].
        deviations: Standard deviation of each coordinate, NaN where not known, shape (c, k, p) [px].
        robot: Where the robot was; None: there is none.
        given: Intrinsics fx, fy, cx, cy and coefficients of a camera with their covariance, of those known beforehand.
    """

    target: str
    points: Array
    camera_names: tuple[str, ...]
    image_sizes: tuple[tuple[int, int], ...]
    lens_models: tuple[str, ...]
    names: tuple[str, ...]
    spots: Array
    deviations: Array
    robot: RobotPoses | None
    given: dict[str, tuple[Array, Array]]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which points were seen, shape (c, k, p)."""
        return np.asarray(np.isfinite(self.spots[..., 0]))
