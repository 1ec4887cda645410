"""Images through a real lens, made from pinhole images."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from im_core.camera_model import CameraModel

FloatImage = NDArray[np.float32]
Array = NDArray[np.float64]

_SOLVER = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-9)


@dataclass(frozen=True)
class Pinhole:
    """An ideal camera that sees all that the lens sees: image size [px], and K, shape (3, 3) [px]."""

    width: int
    height: int
    K: Array


class Lens:
    """Warps a wider pinhole image into the image of a camera with distortion."""

    def __init__(self, camera: CameraModel, renderer_offset: tuple[float, float] = (0.0, 0.0)) -> None:
        """Prepare the warp.

        Args:
            camera: Intrinsics and lens.
            renderer_offset: Error of the pinhole images, column and row [px]: a point appears that much off its place.
        """
        rows, columns = np.mgrid[: camera.height, : camera.width].astype(float)
        pixels = np.stack((columns.ravel(), rows.ravel()), axis=-1)
        same = np.eye(3)
        ideal = np.asarray(cv2.undistortPointsIter(pixels[:, None], camera.K, camera.D, same, same, _SOLVER))[:, 0]
        low, high = ideal.min(axis=0), ideal.max(axis=0)
        size = np.array([camera.width, camera.height])
        focal = (size - 1) / (high - low)
        centre = -low * focal
        K = np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])
        self.pinhole = Pinhole(camera.width, camera.height, K)
        source = (ideal * focal + centre + np.array(renderer_offset)).astype(np.float32)
        source = source.reshape(camera.height, camera.width, 2)
        self._whole, self._fraction = cv2.convertMaps(source[..., 0], source[..., 1], cv2.CV_16SC2)

    def warp(self, image: FloatImage) -> FloatImage:
        """The image through the lens, of an image of :attr:`pinhole`, shape (h, w)."""
        warped = cv2.remap(image, self._whole, self._fraction, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(warped, dtype=np.float32)
