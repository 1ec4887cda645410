"""Mark findings on the image of the monitor: spots, circles, lines and fiducials."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_calibration.targets.detection import Detection
from im_cell.camera_model import CameraModel
from im_vss.edges import EllipseFit, LineFit
from im_vss.fiducial import FiducialFit
from im_vss.managers import VisionClient
from im_vss.monitor import BLUE, GREEN, RED, Curve, Label, Marker
from im_vss.spot import SpotFinding
from im_vss.tools.tool import Tool

Array = NDArray[np.float64]

_TURN = np.linspace(0.0, 2.0 * np.pi, 49)
_ALONG = np.linspace(0.0, 1.0, 17)
_OFF_PX = 8.0
NOT_SEEN = "is not seen whole: out of view, hidden, too far off its axis, or too small"
"""Why a target was not found."""


@dataclass(frozen=True)
class Circles:
    """Circles in an image."""

    fits: tuple[EllipseFit, ...]


@dataclass(frozen=True)
class Lines:
    """Straight edges in an image."""

    fits: tuple[LineFit, ...]


@dataclass(frozen=True)
class Fiducials:
    """Fiducial plates in an image, and why others are not there."""

    fits: tuple[FiducialFit, ...]
    cause: str


@dataclass(frozen=True)
class TargetPoints:
    """Points of a calibration target in an image; None: it is not there."""

    name: str
    found: Detection | None


Seen = SpotFinding | Circles | Lines | Fiducials | TargetPoints


class ToolSpotDisp(Tool):
    """Draws markers on top of the image on each camera's monitor (paper: toolSpotDisp)."""

    name: ClassVar[str] = "tool_spot_disp"

    def __call__(self, client: VisionClient, findings: Mapping[str, Seen]) -> None:
        """Mark the findings in each camera's image, or write the cause of a failure.

        Raises:
            ImError: The display is not to be had.
        """
        markers = tuple(_marker(camera, self.rig.book[camera].model, seen) for camera, seen in findings.items())
        with self.modules.use("vm_spot_disp", client) as (vm_spot_disp, lease):
            vm_spot_disp.mark(lease, markers)


def _marker(camera: str, model: CameraModel, seen: Seen) -> Marker:
    match seen:
        case SpotFinding():
            return _spot(camera, seen)
        case Circles():
            curves = tuple(Curve(_ellipse(fit)) for fit in seen.fits)
            centres = tuple((fit.u, fit.v) for fit in seen.fits)
            return Marker(camera, f"{camera}: {_count(seen.fits, 'circle')}", centres, curves)
        case Lines():
            curves = tuple(Curve(_through_lens(model, fit)) for fit in seen.fits)
            return Marker(camera, f"{camera}: {_count(seen.fits, 'line')}", curves=curves)
        case TargetPoints():
            return _points(camera, seen)
        case Fiducials():
            return _fiducials(camera, model, seen)


def _points(camera: str, seen: TargetPoints) -> Marker:
    if seen.found is None:
        return Marker(camera, f"{camera}: {seen.name} {NOT_SEEN}")
    points = tuple((float(u), float(v)) for u, v in seen.found.points if np.isfinite(u))
    return Marker(camera, f"{camera}: {_count(points, 'point')} of {seen.name}", points)


def _spot(camera: str, finding: SpotFinding) -> Marker:
    spot = finding.spot
    if spot is None:
        return Marker(camera, f"{camera}: {finding.cause}")
    deviation = max(spot.covariance[0, 0], spot.covariance[1, 1]) ** 0.5
    return Marker(camera, f"{camera}: {spot.u:.2f}, {spot.v:.2f} px +- {deviation:.3f}", ((spot.u, spot.v),))


def _ellipse(fit: EllipseFit) -> Array:
    """Return places on an ellipse, shape (n, 2) [px]."""
    cosine, sine = np.cos(fit.angle), np.sin(fit.angle)
    axes = np.array([[cosine, sine], [-sine, cosine]])
    rim = np.stack((fit.major * np.cos(_TURN), fit.minor * np.sin(_TURN)), axis=1)
    return np.asarray(rim @ axes + np.array([fit.u, fit.v]))


def _through_lens(model: CameraModel, fit: LineFit) -> Array:
    """Return places in the image on a line, straight only without the lens, shape (n, 2) [px]."""
    places = fit.start + _ALONG[:, None] * (fit.end - fit.start)
    ideal = (places - model.K[:2, 2]) / model.K[[0, 1], [0, 1]]
    return np.asarray(model.through_lens(ideal))


def _fiducials(camera: str, model: CameraModel, seen: Fiducials) -> Marker:
    """Outline, axes (x red, y green, z blue) and number of each plate."""
    curves: list[Curve] = []
    labels: list[Label] = []
    for fit in seen.fits:
        curves.append(Curve(np.vstack((fit.corners, fit.corners[:1]))))
        for axis, colour in enumerate((RED, GREEN, BLUE)):
            ends = np.zeros((len(_ALONG), 3))
            ends[:, axis] = 0.5 * fit.target.size * _ALONG
            points = fit.pose.translation + ends @ fit.pose.rotation.T
            curves.append(Curve(model.project(model.position + points @ model.R_cam_base), colour))
        u, v = fit.corners.max(axis=0)
        labels.append(Label((float(u) + _OFF_PX, float(v)), f"{fit.target.id} {fit.target.name}"))
    text = f"{camera}: {_count(seen.fits, 'fiducial')}" + (f"; {seen.cause}" if seen.cause else "")
    return Marker(camera, text, (), tuple(curves), tuple(labels))


def _count(fits: tuple[object, ...], what: str) -> str:
    return f"{len(fits)} {what}{'' if len(fits) == 1 else 's'}"
