"""Uncertainty of several cameras together: errors of one calibration are common to the cameras."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from im_cell.camera_model import PARAMETERS
from im_cell.rotations import cross_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CameraCovariance:
    """Joint covariance of parameters of cameras.

    Attributes:
        parameters: Such as ``wall.fx``: camera, and one of :data:`im_cell.camera_model.PARAMETERS`. Of a camera that is
            named at all, those that are not count as exact.
        matrix: Covariance, shape (n, n); units as of the parameters.
    """

    parameters: tuple[str, ...] = ()
    matrix: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras with a known uncertainty."""
        return tuple(dict.fromkeys(_camera(parameter) for parameter in self.parameters))

    def only(self, cameras: Iterable[str]) -> "CameraCovariance":
        """Return the covariance of some of the cameras."""
        wanted = set(cameras)
        places = [rank for rank, parameter in enumerate(self.parameters) if _camera(parameter) in wanted]
        return CameraCovariance(tuple(self.parameters[place] for place in places), self.matrix[np.ix_(places, places)])

    def updated(self, cameras: Iterable[str], anew: "CameraCovariance") -> "CameraCovariance":
        """Return a covariance with some cameras described independently anew; cameras not in `anew` are unknown."""
        changed = set(cameras)
        kept = self.only(set(self.cameras) - changed)
        given = anew.only(changed)
        return CameraCovariance(kept.parameters + given.parameters, scipy.linalg.block_diag(kept.matrix, given.matrix))

    def of(self, cameras: Iterable[str]) -> Array:
        """Return the covariance of all parameters of c cameras, one after the other; 0 for unknown cameras.

        Returns:
            Covariance, shape (18 c, 18 c).
        """
        names = [f"{camera}.{name}" for camera in cameras for name in PARAMETERS]
        places = {parameter: rank for rank, parameter in enumerate(self.parameters)}
        here = [rank for rank, name in enumerate(names) if name in places]
        there = [places[names[rank]] for rank in here]
        matrix = np.zeros((len(names), len(names)))
        matrix[np.ix_(here, here)] = self.matrix[np.ix_(there, there)]
        return matrix

    def on_mount(self, camera: str, origin: Array) -> "CameraCovariance":
        """Return the covariance with the pose of one camera relative to a frame instead of the world.

        Args:
            camera: Its name.
            origin: Origin of the frame from the camera, turned into its axes: ``R_cam_world @ x``, shape (3,) [m].
        """
        change = np.eye(len(self.parameters))
        turn, shift = ([self.parameters.index(f"{camera}.{kind}{axis}") for axis in "xyz"] for kind in ("r", "t"))
        change[np.ix_(shift, turn)] = -cross_matrix(origin)
        return CameraCovariance(self.parameters, change @ self.matrix @ change.T)


def _camera(parameter: str) -> str:
    return parameter.rpartition(".")[0]
