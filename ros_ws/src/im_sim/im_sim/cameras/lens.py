"""Images through a real lens, made from pinhole images."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel

FloatImage = NDArray[np.float32]
Array = NDArray[np.float64]

_SOLVER = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-9)


@dataclass(frozen=True)
class Pinhole:
    """Ideal camera with the full view of the lens: image size [px], and K, shape (3, 3) [px]."""

    width: int
    height: int
    K: Array


class Lens:
    """Warps a wider pinhole image into the image of a camera with distortion.

    Attributes:
        pinhole: The camera of the images that are warped.
        ideal: For each pixel the ideal image point of its centre, shape (h, w, 2) [-].
    """

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
        self.ideal: Array = np.asarray(ideal, dtype=float).reshape(camera.height, camera.width, 2)
        low, high = (np.array([edge(column) for column in ideal.T]) for edge in (np.min, np.max))
        size = np.array([camera.width, camera.height])
        focal = (size - 1) / (high - low)
        centre = -low * focal
        K = np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])
        self.pinhole = Pinhole(camera.width, camera.height, K)
        source = (ideal * focal + centre + np.array(renderer_offset)).astype(np.float32)
        source = source.reshape(camera.height, camera.width, 2)
        self._whole, self._fraction = cv2.convertMaps(source[..., 0], source[..., 1], cv2.CV_16SC2)
        self._nearest = np.rint(source).astype(np.int16)

    def warp_depth(self, depth: FloatImage) -> FloatImage:
        """Warp depths of an image of :attr:`pinhole` through the lens, without interpolation, shape (h, w) [m]."""
        columns = np.clip(self._nearest[..., 0], 0, depth.shape[1] - 1)
        rows = np.clip(self._nearest[..., 1], 0, depth.shape[0] - 1)
        return np.asarray(depth[rows, columns], dtype=np.float32)

    def warp(self, image: FloatImage) -> FloatImage:
        """The image through the lens, of an image of :attr:`pinhole`, shape (h, w)."""
        warped = cv2.remap(image, self._whole, self._fraction, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(warped, dtype=np.float32)


def vignette(camera: CameraModel, loss: float) -> FloatImage:
    """Return the kept share of brightness of each pixel, shape (h, w): the loss grows with the square of the distance.

    Args:
        camera: Image size and principal point.
        loss: Share that is lost at half of the image's diagonal.
    """
    columns = np.arange(camera.width) - camera.K[0, 2]
    rows = np.arange(camera.height) - camera.K[1, 2]
    squares = (columns**2)[None, :] + (rows**2)[:, None]
    return np.asarray(1.0 - loss * squares / (0.25 * (camera.width**2 + camera.height**2)), dtype=np.float32)
