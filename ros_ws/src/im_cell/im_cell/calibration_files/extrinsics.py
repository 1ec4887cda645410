"""Poses of cameras as YAML: a `tf2_msgs/TFMessage`, as shown by ``ros2 topic echo /tf_static``."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
import pydantic
import yaml
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.rotations import UNIT_TOLERANCE, matrix_of_quaternion, quaternion_of_matrix
from im_core.config import Model, load_model

EXTRINSICS = "extrinsics.yaml"
"""Name of the file."""
FRAME_END = "_optical_frame"
_FARTHEST_M = 1000.0


@dataclass(frozen=True)
class CameraPose:
    """Where a camera is.

    Attributes:
        parent: Frame that it is fixed to.
        R_cam_base: Rotation parent -> camera, shape (3, 3).
        t_cam_base: Origin of the parent in the camera frame, shape (3,) [m].
    """

    parent: str
    R_cam_base: NDArray[np.float64]
    t_cam_base: NDArray[np.float64]

    @classmethod
    def of(cls, parent: str, model: CameraModel) -> Self:
        """The pose of a camera model."""
        return cls(parent, model.R_cam_base, model.t_cam_base)


Coordinate = Annotated[float, pydantic.Field(ge=-_FARTHEST_M, le=_FARTHEST_M)]


class Translation(Model):
    """`geometry_msgs/Vector3` [m]."""

    x: Coordinate
    y: Coordinate
    z: Coordinate


class Quaternion(Model):
    """`geometry_msgs/Quaternion`, of length 1."""

    x: float
    y: float
    z: float
    w: float

    @pydantic.model_validator(mode="after")
    def _unit(self) -> Self:
        length = math.hypot(self.x, self.y, self.z, self.w)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"the quaternion's length is {length:.6g}, it must be 1")
        return self


class Transform(Model):
    """`geometry_msgs/Transform`: the child frame in the parent frame."""

    translation: Translation
    rotation: Quaternion


class Header(pydantic.BaseModel):
    """`std_msgs/Header`; the stamp is passed over."""

    model_config = pydantic.ConfigDict(frozen=True)

    frame_id: str


class TransformStamped(Model):
    """`geometry_msgs/TransformStamped`."""

    header: Header
    child_frame_id: str
    transform: Transform

    @property
    def pose(self) -> CameraPose:
        """The same, from the camera's side."""
        place, turn = self.transform.translation, self.transform.rotation
        R = matrix_of_quaternion([turn.x, turn.y, turn.z, turn.w]).T
        return CameraPose(self.header.frame_id, R, -R @ np.array([place.x, place.y, place.z]))


class ExtrinsicsFile(Model):
    """Contents of ``extrinsics.yaml``."""

    transforms: Annotated[tuple[TransformStamped, ...], pydantic.Field(min_length=1)]


def read_extrinsics(path: Path) -> ExtrinsicsFile:
    """Read poses.

    Raises:
        ConfigError: The file cannot be read, or holds none; the message names file, line and field.
    """
    return load_model(path, ExtrinsicsFile)


def frame_of(camera: str) -> str:
    """Name of a camera's optical frame.

    >>> frame_of("wall")
    'wall_optical_frame'
    """
    return f"{camera}{FRAME_END}"


def extrinsics_yaml(poses: Mapping[str, CameraPose]) -> str:
    """The file of the poses of cameras, by name."""
    content = {"transforms": [_transform(camera, pose) for camera, pose in poses.items()]}
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)


def _transform(camera: str, pose: CameraPose) -> dict[str, Any]:
    translation = -pose.R_cam_base.T @ pose.t_cam_base
    return {
        "header": {"frame_id": pose.parent},
        "child_frame_id": frame_of(camera),
        "transform": {
            "translation": dict(zip("xyz", map(float, translation), strict=True)),
            "rotation": dict(zip("xyzw", quaternion_of_matrix(pose.R_cam_base.T), strict=True)),
        },
    }
