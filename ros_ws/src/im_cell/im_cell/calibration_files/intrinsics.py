"""Intrinsics of a camera as YAML, in the format of ROS's `camera_info_manager` or of OpenCV."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import pydantic
import yaml
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.lens import lens_of
from im_core.config import FieldError, load_model
from im_core.errors import DataError

Array = NDArray[np.float64]

_FOCAL_WIDTHS = 0.05, 100.0
"""From fish eyes to telescopes."""
_CENTRE_BESIDE = 0.5
"""How far off an image that was cut from a larger one may have its principal point."""
_MIDDLE = np.linspace(0.25, 0.75, 5)
"""Where in an image no lens folds it; in its corners, the models of wide ones do."""


@dataclass(frozen=True)
class Rectified:
    """Rectification part of a `CameraInfo`: R, shape (3, 3), and P, shape (3, 4) [px]."""

    R: Array
    P: Array


def monocular(model: CameraModel) -> Rectified:
    """Return R and P of a camera without a stereo pair."""
    return Rectified(np.eye(3), np.hstack((model.K, np.zeros((3, 1)))))


class Matrix(pydantic.BaseModel):
    """Matrix as written by `camera_info_manager`, row by row."""

    model_config = pydantic.ConfigDict(frozen=True, allow_inf_nan=False)

    rows: int
    cols: int
    data: tuple[float, ...]

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        if len(self.data) != self.rows * self.cols or self.rows < 1:
            raise ValueError(f"{self.rows} x {self.cols} is {self.rows * self.cols} numbers, data has {len(self.data)}")
        return self

    @property
    def array(self) -> Array:
        """Values of the matrix, shape (rows, cols)."""
        return np.array(self.data).reshape(self.rows, self.cols)


def _of_shape(*shapes: tuple[int, int]) -> pydantic.AfterValidator:
    def check(matrix: Matrix) -> Matrix:
        if (matrix.rows, matrix.cols) not in shapes:
            allowed = " or ".join(f"{rows} x {columns}" for rows, columns in shapes)
            raise ValueError(f"the matrix is {matrix.rows} x {matrix.cols}, it must be {allowed}")
        return matrix

    return pydantic.AfterValidator(check)


def _coefficients(matrix: Matrix, info: pydantic.ValidationInfo) -> Matrix:
    if 1 not in (matrix.rows, matrix.cols):
        raise ValueError(f"the matrix is {matrix.rows} x {matrix.cols}, it must be one row or one column")
    if (model := info.data.get("distortion_model")) is not None:
        try:
            lens_of(model).all_of(matrix.data)
        except DataError as error:
            raise ValueError(error.message) from error
    return matrix


def _camera_matrix(matrix: Matrix) -> Matrix:
    K = matrix.array
    if np.any(K[[0, 1, 2, 2], [1, 0, 0, 1]] != 0.0) or K[2, 2] != 1.0:
        raise ValueError(f"{K.ravel().tolist()} is not [fx 0 cx; 0 fy cy; 0 0 1]")
    return matrix


def implausible(K: Array, width: int, height: int) -> str:
    """Return the reason why no camera has the given intrinsics, as a clause; empty if plausible.

    Args:
        K: Camera matrix, shape (3, 3) [px].
        width: Width of its images [px].
        height: Height of its images [px].

    >>> implausible(K, 640, 480)
    ''
    >>> implausible(K / 100.0, 640, 480)
    'fx is 6 px, it must be within 32 and 64000, 0.05 to 100 image widths'
    """
    focal, beside = _FOCAL_WIDTHS, _CENTRE_BESIDE
    for name, value, low, high, why in (
        ("fx", K[0, 0], focal[0] * width, focal[1] * width, f"{focal[0]:g} to {focal[1]:g} image widths"),
        ("fy", K[1, 1], focal[0] * width, focal[1] * width, f"{focal[0]:g} to {focal[1]:g} image widths"),
        ("cx", K[0, 2], -beside * width, (1.0 + beside) * width, f"at most {beside:g} image widths outside"),
        ("cy", K[1, 2], -beside * height, (1.0 + beside) * height, f"at most {beside:g} image heights outside"),
    ):
        if not low <= value <= high:
            return f"{name} is {value:g} px, it must be within {low:g} and {high:g}, {why}"
    return ""


def folded(model: CameraModel) -> str:
    """Return the reason why no lens is like the lens of a camera, as a clause; empty if plausible."""
    u, v = np.meshgrid(_MIDDLE * model.width, _MIDDLE * model.height)
    try:
        model.undistort(np.stack((u, v), axis=-1))
    except DataError:
        return f"D = {model.D.tolist()} folds the image in its middle half, no lens of model {model.lens.name} does"
    return ""


Side = Annotated[int, pydantic.Field(ge=1)]


class IntrinsicsFile(pydantic.BaseModel):
    """Contents of a camera's file; fields of other tools, not listed here, are ignored.

    Attributes:
        image_width, image_height: Size of the image [px].
        camera_name: Name of the camera, as whoever wrote the file called it.
        camera_matrix: K [px].
        distortion_model: `plumb_bob`, `rational_polynomial` or `equidistant`.
        distortion_coefficients: Those of the model; `plumb_bob` may do without k3.
        rectification_matrix, projection_matrix: R and P; they follow from the rest, and are not used.
    """

    model_config = pydantic.ConfigDict(frozen=True, allow_inf_nan=False)

    image_width: Side
    image_height: Side
    camera_name: str = ""
    camera_matrix: Annotated[Matrix, _of_shape((3, 3)), pydantic.AfterValidator(_camera_matrix)]
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = "plumb_bob"
    distortion_coefficients: Annotated[Matrix, pydantic.AfterValidator(_coefficients)]
    rectification_matrix: Annotated[Matrix, _of_shape((3, 3))] | None = None
    projection_matrix: Annotated[Matrix, _of_shape((3, 4))] | None = None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _lens_of_opencv(cls, content: Any) -> Any:
        """Add the lens model to a file of OpenCV, by the number of coefficients or the mark of a fisheye."""
        match content:
            case {"distortion_model": _}:
                return content
            case {"fisheye_model": 1}:
                return {**content, "distortion_model": "equidistant"}
            case {"distortion_coefficients": {"data": [_, _, _, _, _, _, _, _]}}:
                return {**content, "distortion_model": "rational_polynomial"}
        return content

    @pydantic.model_validator(mode="after")
    def _plausible(self) -> Self:
        if why_not := implausible(self.camera_matrix.array, self.image_width, self.image_height):
            raise FieldError(("camera_matrix",), why_not)
        if why_not := folded(self.model):
            raise FieldError(("distortion_coefficients",), why_not)
        return self

    @property
    def model(self) -> CameraModel:
        """Intrinsics and lens, without a pose."""
        D = lens_of(self.distortion_model).all_of(self.distortion_coefficients.data)
        size = (self.image_width, self.image_height)
        return CameraModel(*size, self.camera_matrix.array, D, distortion_model=self.distortion_model)


def read_intrinsics(path: Path) -> IntrinsicsFile:
    """Read a camera's file.

    Raises:
        ConfigError: It cannot be read, or is none; the message names file, line and field.
    """
    return load_model(path, IntrinsicsFile, plain=plain_yaml)


def plain_yaml(text: str) -> str:
    """Return YAML of OpenCV's ``FileStorage`` without header and tags of OpenCV; other YAML stays unchanged."""
    return re.sub(r"\A%YAML[: ]", "#YAML ", text).replace("!!opencv-matrix", "")


def camera_info_yaml(name: str, model: CameraModel, rectified: Rectified | None = None) -> str:
    """The file of a camera, with the first line without which OpenCV's ``FileStorage`` takes it for no YAML.

    Args:
        name: Name of the camera.
        model: Its intrinsics and lens.
        rectified: Its R and P; None: those of a single camera.

    Returns:
        Text of the file.

    >>> camera_info_yaml("wall", camera).splitlines()[:3]
    ['%YAML 1.1', '---', 'image_width: 640']
    """
    rectified = rectified or monocular(model)
    content: dict[str, Any] = {
        "image_width": model.width,
        "image_height": model.height,
        "camera_name": name,
        "camera_matrix": _matrix(model.K),
        "distortion_model": model.distortion_model,
        "distortion_coefficients": _matrix(model.D[None, :]),
        "rectification_matrix": _matrix(rectified.R),
        "projection_matrix": _matrix(rectified.P),
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120, version=(1, 1))


def _matrix(values: Array) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": [float(value) for value in values.ravel()]}
