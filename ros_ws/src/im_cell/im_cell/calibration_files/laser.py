"""Calibration of the laser scanner as YAML."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pydantic
import yaml
from numpy.typing import NDArray

from im_cell.calibration_files.covariance import Rows, covariance_of
from im_cell.laser_model import LaserModel
from im_core.config import Model, load_model

Array = NDArray[np.float64]
LASER = "laser.yaml"
"""Name of the file."""
PARAMETERS = 10
_TOLERANCE = 1e-6

Positive = Annotated[float, pydantic.Field(gt=0.0)]
Row = tuple[float, float, float]


@dataclass(frozen=True)
class LaserEstimate:
    """Estimated laser scanner, and the covariance of the ten parameters, shape (10, 10)."""

    model: LaserModel
    covariance: Array


def _rotation(rows: tuple[Row, Row, Row]) -> tuple[Row, Row, Row]:
    R = np.array(rows)
    with np.errstate(all="ignore"):
        off = np.abs(R @ R.T - np.eye(3)).max()
        if not off <= _TOLERANCE or np.linalg.det(R) < 0.0:
            raise ValueError(f"the matrix is no rotation: R R' is off the identity by {off:.3g}, det R must be 1")
    return rows


def _covariance(rows: Rows) -> Rows:
    return covariance_of(rows, PARAMETERS)


class LaserFile(Model):
    """Contents of ``laser.yaml``; see :class:`im_cell.laser_model.LaserModel`.

    Attributes:
        rotation: Rotation scanner -> world.
        position: Centre of mirror 2 in the world [m].
        gain: True angle of each mirror by the one it reports.
        offset: Angle of mirror 1 when it reports zero [rad].
        gap: Distance of the mirrors [m].
        covariance: Of turn x, y, z [rad], position x, y, z [m], gains, offset [rad] and gap [m].
    """

    rotation: Annotated[tuple[Row, Row, Row], pydantic.AfterValidator(_rotation)]
    position: Row
    gain: tuple[Positive, Positive]
    offset: float
    gap: Positive
    covariance: Annotated[Rows, pydantic.AfterValidator(_covariance)]

    @property
    def estimate(self) -> LaserEstimate:
        """Model and covariance."""
        model = LaserModel(np.array(self.rotation), np.array(self.position), self.gap, self.gain, self.offset)
        return LaserEstimate(model, np.array(self.covariance))


def read_laser(path: Path) -> LaserEstimate:
    """Read a scanner's file.

    Raises:
        ConfigError: It cannot be read, or is none; the message names file, line and field.
    """
    return load_model(path, LaserFile).estimate


def laser_yaml(estimate: LaserEstimate) -> str:
    """The file of a scanner."""
    model = estimate.model
    content = {
        "rotation": model.rotation.tolist(),
        "position": model.position.tolist(),
        "gain": list(map(float, model.gain)),
        "offset": float(model.offset),
        "gap": float(model.gap),
        "covariance": estimate.covariance.tolist(),
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
