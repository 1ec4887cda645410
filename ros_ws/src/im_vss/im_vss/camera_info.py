"""Camera calibrations as YAML, in the format of ROS's `camera_info_manager`."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from im_core.camera_model import CameraModel


@dataclass(frozen=True)
class Rectified:
    """What a `CameraInfo` says of rectified images: R, shape (3, 3), and P, shape (3, 4) [px]."""

    R: NDArray[np.float64]
    P: NDArray[np.float64]


def monocular(model: CameraModel) -> Rectified:
    """R and P of a camera that belongs to no stereo pair."""
    return Rectified(np.eye(3), np.hstack((model.K, np.zeros((3, 1)))))


def camera_info_yaml(name: str, model: CameraModel, rectified: Rectified | None = None) -> str:
    """The calibration file of a camera.

    Args:
        name: Name of the camera.
        model: Its intrinsics and lens.
        rectified: Its R and P; None: those of a single camera.

    Returns:
        Text of the file.
    """
    rectified = rectified or monocular(model)
    content: dict[str, Any] = {
        "image_width": model.width,
        "image_height": model.height,
        "camera_name": name,
        "camera_matrix": _matrix(model.K),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _matrix(model.D[None, :]),
        "rectification_matrix": _matrix(rectified.R),
        "projection_matrix": _matrix(rectified.P),
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)


def _matrix(values: NDArray[np.float64]) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": [float(value) for value in values.ravel()]}
