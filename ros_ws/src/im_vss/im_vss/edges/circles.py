"""Circles, which a camera sees as ellipses."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from im_cell.sensor import SensorNoise
from im_core.config import Model
from im_vss.edges.step import StepFit, fit_step

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_BLOCK_PX = 51
_OFFSET_DN = 6
_FLATTEST = 0.25
_AREA_MISMATCH = 0.15
_NEAR_PX = 1.5


class CircleGates(Model):
    """Limits of a circle.

    Attributes:
        radius_min, radius_max: Range of the mean of the half axes [px].
        half: How far inside and outside of its edge pixels are used [px].
        contrast_snr: Smallest contrast over its standard deviation [-].
        chi2_per_dof: Largest misfit of a blurred elliptic step [-].
        coverage: Smallest share of the circumference that must be seen.
    """

    radius_min: float = Field(ge=3.0)
    radius_max: float = Field(gt=3.0)
    half: float = Field(ge=2.0)
    contrast_snr: float = Field(gt=0.0)
    chi2_per_dof: float = Field(gt=1.0)
    coverage: float = Field(gt=0.0, le=1.0)


@dataclass(frozen=True)
class EllipseFit:
    """Ellipse: centre and the covariance, half axes [px], angle of the major axis [rad], and the fit of the edge."""

    u: float
    v: float
    covariance: Array
    major: float
    minor: float
    angle: float
    coverage: float
    fit: StepFit

    @property
    def rms(self) -> float:
        """Scatter of the edge, in parts of one pixel of the length [px]."""
        length = np.pi * (self.major + self.minor)
        return float(np.sqrt(np.trace(self.covariance) / 4.0 * length))


def find_circles(image: Image, noise: SensorNoise, gates: CircleGates) -> list[EllipseFit]:
    """Find dark and bright discs, the most certain contrast first.

    Args:
        image: Pixels, shape (h, w) [DN].
        noise: Noise of the sensor.
        gates: What a circle must be like.
    """
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    found: list[EllipseFit] = []
    for kind, offset in ((cv2.THRESH_BINARY_INV, _OFFSET_DN), (cv2.THRESH_BINARY, -_OFFSET_DN)):
        mask = cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, kind, _BLOCK_PX, offset)
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            start = _candidate(contour[:, 0].astype(float), gates)
            fit = _fit(image, start, noise, gates) if start is not None else None
            if fit is not None and not any(np.hypot(fit.u - o.u, fit.v - o.v) < _NEAR_PX for o in found):
                found.append(fit)
    return sorted(found, key=lambda fit: -fit.fit.contrast_snr)


def _candidate(contour: Array, gates: CircleGates) -> Array | None:
    """Return centre, half axes and angle of a contour similar to an ellipse, shape (5,)."""
    if len(contour) < 4.0 * gates.radius_min:
        return None
    (u, v), (first, second), degrees = cv2.fitEllipse(contour.astype(np.float32))
    a, b = first / 2.0, second / 2.0
    if not gates.radius_min <= (a + b) / 2.0 <= gates.radius_max or min(a, b) < _FLATTEST * max(a, b):
        return None
    area = float(cv2.contourArea(contour.astype(np.float32)))
    if abs(area / (np.pi * a * b) - 1.0) > _AREA_MISMATCH:
        return None
    return np.array([u, v, a, b, np.deg2rad(degrees)])


def _fit(image: Image, start: Array, noise: SensorNoise, gates: CircleGates) -> EllipseFit | None:
    reach = start[2:4].max() + gates.half + 1.0
    low = np.maximum(np.floor(start[:2] - reach), 0).astype(int)
    high = np.minimum(np.ceil(start[:2] + reach + 1), [image.shape[1], image.shape[0]]).astype(int)
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    chosen = np.abs(_distance(start, columns, rows)) <= gates.half
    u, v, values = columns[chosen], rows[chosen], image[rows[chosen], columns[chosen]].astype(float)
    round_ = abs(start[2] - start[3]) < 0.1 * start[2]
    shape = start[:4] if round_ else np.array([*start[:4], start[4] * start[2]])

    def full(parameters: Array) -> Array:
        """With the angle, which is fitted as the shift of a vertex [px], and not at all where axes are alike."""
        angle = start[4] if round_ else parameters[4] / start[2]
        return np.array([*parameters[:4], angle])

    fit = fit_step(values, lambda parameters: _distance(full(parameters), u, v), shape, noise)
    if fit is None or fit.chi2_per_dof > gates.chi2_per_dof or fit.contrast_snr < gates.contrast_snr:
        return None
    centre_u, centre_v, a, b, angle = full(fit.shape)
    turn = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    rim_u = centre_u + a * np.cos(turn) * np.cos(angle) - b * np.sin(turn) * np.sin(angle)
    rim_v = centre_v + a * np.cos(turn) * np.sin(angle) + b * np.sin(turn) * np.cos(angle)
    seen = (rim_u >= 0) & (rim_u <= image.shape[1] - 1) & (rim_v >= 0) & (rim_v <= image.shape[0] - 1)
    if min(a, b) <= 0.0 or seen.mean() < gates.coverage:
        return None
    if a < b:
        a, b, angle = b, a, angle + np.pi / 2.0
    angle = (angle + np.pi / 2.0) % np.pi - np.pi / 2.0
    return EllipseFit(
        float(centre_u), float(centre_v), fit.covariance[:2, :2], float(a), float(b), float(angle), float(seen.mean()),
        fit,
    )  # fmt: skip


def _distance(ellipse: Array, columns: Array, rows: Array) -> Array:
    """Distance outwards from an ellipse (u, v, a, b, angle), exact for circles and to first order else [px]."""
    u, v, a, b, angle = ellipse
    x = (columns - u) * np.cos(angle) + (rows - v) * np.sin(angle)
    y = (rows - v) * np.cos(angle) - (columns - u) * np.sin(angle)
    k1 = np.hypot(x / a, y / b)
    k2 = np.maximum(np.hypot(x / a**2, y / b**2), 1e-12)
    return np.asarray(k1 * (k1 - 1.0) / k2)
