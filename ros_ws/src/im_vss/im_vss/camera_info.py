"""Camera calibrations as YAML, in the format of ROS's `camera_info_manager`."""

from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from im_core.camera_model import CameraModel


def projection_matrix(model: CameraModel) -> NDArray[np.float64]:
    """P of a monocular camera without rectification, shape (3, 4) [px]."""
    return np.hstack((model.K, np.zeros((3, 1))))


def camera_info_yaml(name: str, model: CameraModel) -> str:
    """The calibration file of a camera.

    Args:
        name: Name of the camera.
        model: Its intrinsics and lens.

    Returns:
        Text of the file.
    """
    content: dict[str, Any] = {
        "image_width": model.width,
        "image_height": model.height,
        "camera_name": name,
        "camera_matrix": _matrix(model.K),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _matrix(model.D[None, :]),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(projection_matrix(model)),
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)


def _matrix(values: NDArray[np.float64]) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": [float(value) for value in values.ravel()]}
