"""Uncertainty of cameras as YAML: the names of the parameters, and one covariance of all parameters."""

from pathlib import Path
from typing import Self

import numpy as np
import pydantic
import yaml

from im_cell.camera_covariance import CameraCovariance
from im_core.config import FieldError, Model, load_model

COVARIANCE = "covariance.yaml"
"""Name of the file."""
_TOLERANCE = 1e-6

Rows = tuple[tuple[float, ...], ...]


def covariance_of(rows: Rows, size: int) -> Rows:
    """Return the rows, if the rows are a covariance of the given number of parameters.

    Raises:
        ValueError: They are not.
    """
    if len(rows) != size or any(len(row) != size for row in rows):
        raise ValueError(f"{size} rows of {size} numbers are needed")
    S = np.array(rows)
    if np.any(np.diag(S) <= 0.0):
        raise ValueError("variances on the diagonal must be > 0")
    spread = np.sqrt(np.diag(S))
    with np.errstate(all="ignore"):
        correlation = S / spread / spread[:, None]
    bounded = np.abs(correlation).max() <= 1.0 + _TOLERANCE
    symmetric = bounded and np.allclose(correlation, correlation.T, rtol=0.0, atol=_TOLERANCE)
    if not symmetric or np.linalg.eigvalsh(correlation).min() < -_TOLERANCE:
        raise ValueError("not symmetric and positive")
    return rows


class CovarianceFile(Model):
    """Contents of ``covariance.yaml``; see :class:`im_cell.camera_covariance.CameraCovariance`."""

    parameters: tuple[str, ...] = pydantic.Field(min_length=1)
    covariance: Rows

    @pydantic.model_validator(mode="after")
    def _fits(self) -> Self:
        for rank, parameter in enumerate(self.parameters):
            if parameter in self.parameters[:rank]:
                raise FieldError(("parameters", rank), f"'{parameter}': given twice")
        try:
            covariance_of(self.covariance, len(self.parameters))
        except ValueError as error:
            raise FieldError(("covariance",), str(error)) from None
        return self


def read_covariance(path: Path) -> CameraCovariance:
    """Read how well cameras are known.

    Raises:
        ConfigError: The file cannot be read, or is none; the message names file, line and field.
    """
    content = load_model(path, CovarianceFile)
    return CameraCovariance(content.parameters, np.array(content.covariance))


def covariance_yaml(covariance: CameraCovariance) -> str:
    """The file of a covariance of at least one camera."""
    content = {"parameters": list(covariance.parameters), "covariance": covariance.matrix.tolist()}
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
