"""True values of the simulated cell, as the file ``truth.json``.

Written by the testbed; read by what plays hardware (the camera process) and, after calibration is done, by whoever
prints its error. Nothing that estimates may read it.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from im_cell.laser_model import LaserModel
from im_cell.robot.parameters import Positive, Vector
from im_core.config import Model, faults
from im_core.errors import DataError
from im_core.text.jsontext import load_json

FILE_NAME = "truth.json"
Matrix = tuple[Vector, Vector, Vector]


class CameraTruth(Model):
    """A camera.

    Attributes:
        parent: Frame it is fixed to, ``world`` (the base) or a link.
        width, height: Image size [px].
        K: Intrinsics [px].
        D: Distortion k1, k2, p1, p2, k3.
        R_cam_base, t_cam_base_m: Pose, ``x_cam = R x_parent + t`` [m].
    """

    parent: str
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    K: Matrix
    D: Annotated[tuple[float, ...], Field(min_length=5, max_length=5)]
    R_cam_base: Matrix
    t_cam_base_m: Vector


class LedTruth(Model):
    """Wrist light: offset and outward axis in the frame of the wrist [m], diameter [m]."""

    offset_m: Vector
    axis: Vector
    diameter_m: Positive


class LaserTruth(Model):
    """The laser scanner, see :class:`im_cell.laser_model.LaserModel`.

    Attributes:
        rotation, position_m: Pose, ``x_world = R x_scanner + t`` [m].
        gain: Of the mirrors' angles [-].
        offset: Of mirror 1 [rad].
        gap_m: Between the mirrors [m].
    """

    rotation: Matrix
    position_m: Vector
    gain: tuple[float, float]
    offset: float
    gap_m: Positive

    def model(self) -> LaserModel:
        """How the beam really goes."""
        return LaserModel(np.array(self.rotation), np.array(self.position_m), self.gap_m, self.gain, self.offset)


class CellTruth(Model):
    """True cameras and lights by name, the laser scanner if there is one, and the random seed of all.

    Attributes:
        objects: Present poses of the free bodies: position [m] and quaternion x, y, z, w; only where the testbed is
            asked.
    """

    seed: int
    cameras: dict[str, CameraTruth]
    leds: dict[str, LedTruth]
    laser: LaserTruth | None
    objects: dict[str, tuple[float, ...]] = Field(default_factory=dict)


def load_truth(path: Path) -> CellTruth:
    """Read a truth file.

    Raises:
        DataError: It is missing or malformed.
    """
    try:
        return CellTruth.model_validate(load_json(path))
    except ValidationError as error:
        fault = faults(error, CellTruth)[0]
        raise DataError(f"{path}: is not a truth file: {fault.field}: {fault.sentence}", file=str(path)) from error
