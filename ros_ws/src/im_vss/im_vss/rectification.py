"""Rectified images: those of a pinhole camera without a lens, in the plane of the stereo pair."""

import cv2
import numpy as np

from im_cell.calibration_files.intrinsics import Rectified
from im_cell.camera_model import CameraModel
from im_cell.frames import Image


class ImageRectification:
    """Map from a camera's image to the rectified one (Hartley and Zisserman, section 11.12).

    A pixel of the rectified image is a ray of the camera with the matrix P, turned back by R; the lens of the real
    camera says where that ray meets its image.

    Args:
        model: Intrinsics and lens of the camera.
        rectified: R and P of its camera info.
    """

    def __init__(self, model: CameraModel, rectified: Rectified) -> None:
        rows, columns = np.indices((model.height, model.width), dtype=float)
        pixels = np.stack((columns, rows, np.ones_like(rows)), axis=-1)
        rays = pixels @ np.linalg.inv(rectified.P[:, :3]).T @ rectified.R  # rows, to which R^T is applied
        places = model.through_lens(rays[..., :2] / rays[..., 2:]).astype(np.float32)
        self._columns, self._rows = places[..., 0], places[..., 1]

    def apply(self, image: Image) -> Image:
        """Return the rectified image, shape (height, width) as the given one; black where the camera does not see."""
        return np.asarray(cv2.remap(image, self._columns, self._rows, cv2.INTER_LINEAR), dtype=np.uint8)
