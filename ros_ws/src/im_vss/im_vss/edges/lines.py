"""Straight edges anywhere in an image."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from im_cell.camera_model import CameraModel
from im_cell.sensor import SensorNoise
from im_core.config import Model
from im_core.errors import DataError
from im_vss.edges.step import Image, StraightEdge, follow_edge, undistorted_by_parameters

Array = NDArray[np.float64]

_MARGIN_PX = 3.0


class LineGates(Model):
    """Limits of a line.

    Attributes:
        length: Shortest [px].
        half: How far to both sides of it pixels are used [px].
        contrast_snr: Smallest contrast over its standard deviation [-].
        chi2_per_dof: Largest misfit of a straight blurred step [-].
        most: Lines that are handed on at most.
    """

    length: float = Field(ge=12.0)
    half: float = Field(ge=2.0)
    contrast_snr: float = Field(gt=0.0)
    chi2_per_dof: float = Field(gt=1.0)
    most: int = Field(ge=1)


@dataclass(frozen=True)
class LineFit:
    """A line.

    Attributes:
        start: Its beginning in undistorted pixels, shape (2,) [px].
        end: Its end, shape (2,) [px].
        edge: The edge that was fitted.
        covariance: Of (offset across the line at its middle [px], angle [rad]), by pixels and lens, shape (2, 2).
    """

    start: Array
    end: Array
    edge: StraightEdge
    covariance: Array

    @property
    def rms(self) -> float:
        """Scatter of the edge, in parts of one pixel of the length [px]."""
        return float(np.sqrt(self.edge.fit.covariance[0, 0] * self.edge.length))


def find_lines(
    image: Image, camera: CameraModel, noise: SensorNoise, gates: LineGates, calibration: Array
) -> list[LineFit]:
    """Find straight edges; longest first.

    Candidates: R. Grompone von Gioi and others, "LSD: a line segment detector", IPOL 2012, as in OpenCV.

    Args:
        image: Pixels, shape (h, w) [DN].
        camera: Intrinsics and lens; what is straight in the world is fitted as straight.
        noise: Noise of the sensor.
        gates: What a line must be like.
        calibration: Covariance of the camera's parameters, see :data:`im_cell.camera_model.PARAMETERS`, shape (18, 18).
    """
    segments = cv2.createLineSegmentDetector().detect(cv2.GaussianBlur(image, (0, 0), 1.0))[0]
    if segments is None:
        return []
    found: list[LineFit] = []
    for ends in sorted(segments.reshape(-1, 2, 2).astype(float), key=lambda pair: -np.linalg.norm(pair[1] - pair[0])):
        if np.linalg.norm(ends[1] - ends[0]) < gates.length or len(found) == gates.most:
            break
        try:
            edge = follow_edge(image, camera, ends, gates.half, _MARGIN_PX, noise)
        except DataError:  # the lens model does not hold there
            continue
        if edge is None or edge.fit.contrast_snr < gates.contrast_snr or edge.fit.chi2_per_dof > gates.chi2_per_dof:
            continue
        if not any(_same(edge, other.edge) for other in found):
            reach = 0.5 * edge.length * edge.direction
            start, end = edge.middle - reach, edge.middle + reach
            found.append(LineFit(start, end, edge, edge_covariance(edge, camera, calibration)))
    return found


def edge_covariance(edge: StraightEdge, camera: CameraModel, calibration: Array) -> Array:
    """Covariance of (offset across an edge at the middle [px], angle [rad]) by pixels and lens, shape (2, 2).

    Args:
        edge: The edge.
        camera: The camera it was fitted with.
        calibration: Covariance of the camera's parameters, shape (18, 18).
    """
    reach = 0.5 * edge.length * edge.direction
    ends = undistorted_by_parameters(camera, np.stack((edge.middle - reach, edge.middle + reach)))
    first, second = edge.normal @ ends
    moved = np.stack((0.5 * (first + second), (second - first) / edge.length))
    return np.asarray(edge.fit.covariance + moved @ calibration @ moved.T)


def _same(first: StraightEdge, second: StraightEdge) -> bool:
    """Whether an edge is a piece of another, longer one."""
    away = first.middle - second.middle
    aligned = first.direction @ second.direction > 0.999
    return bool(aligned and abs(away @ second.normal) < 1.0 and abs(away @ second.direction) < 0.5 * second.length)
