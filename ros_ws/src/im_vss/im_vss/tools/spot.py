"""Tools for the spot of a light in an image or a region, and for the point from two images."""

from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.frames import Frame, Image
from im_core.errors import DataError, StateError
from im_vss.spot import SearchDisc, SpotFinding, SpotFit, find_spot
from im_vss.stereo import Point, epipolar_distance, triangulate
from im_vss.tools.tool import Tool

_SMALLEST_PX = 16


@dataclass(frozen=True)
class Region:
    """A rectangle of pixels: upper left corner and size [px]; a width of 0 stands for the whole image."""

    u: int = 0
    v: int = 0
    width: int = 0
    height: int = 0


WHOLE = Region()
"""The whole image."""


def check_region(region: Region, width: int, height: int) -> Region:
    """Check a region of an image of some size [px].

    Raises:
        DataError: It is not in the image, or too small to find anything in.
    """
    if region.width == 0:
        return WHOLE
    inside = region.u >= 0 and region.v >= 0 and region.u + region.width <= width
    if not inside or region.v + region.height > height or min(region.width, region.height) < _SMALLEST_PX:
        raise DataError(
            f"a region of {region.width} x {region.height} px at ({region.u}, {region.v}) px is not in the image of "
            f"{width} x {height} px, or smaller than {_SMALLEST_PX} px"
        )
    return region


def cut(image: Image, region: Region) -> tuple[Image, int, int]:
    """Return the pixels of a region, shape (h, w), and the upper left corner [px]."""
    if region.width == 0:
        return image, 0, 0
    return image[region.v : region.v + region.height, region.u : region.u + region.width], region.u, region.v


class ToolSpotFind(Tool):
    """Finds the light in a pair of frames; a calculation, without a Vision Module (paper: toolSpotFind)."""

    name: ClassVar[str] = "tool_spot_find"

    def __call__(self, off: Frame, on: Frame, light: NDArray[np.float64] | None = None) -> SpotFinding:
        """The spot in the difference of two frames of one camera.

        Args:
            off: Frame with the lights strobed off.
            on: Frame with the lights as commanded.
            light: Where the robot's pose put the light when `on` was exposed, shape (3,) [m]; None: not known then.
        """
        sensor = on.controls.of(self.rig.settings.sensor)
        region = self._region(on, light)
        fixed = self.rig.book[on.camera].parent == "world"  # on an arm the prediction is told, and binds nothing
        finding = find_spot(on.image, off.image, sensor, self.rig.settings.spot, region if fixed else None)
        finding = replace(finding, region=region)
        if finding.spot is None and not finding.candidates and (why := self.rig.why_dark()):
            return replace(finding, cause=f"no light seen: {why}")
        return finding

    def _region(self, frame: Frame, light: NDArray[np.float64] | None) -> SearchDisc | None:
        """Where the light must be if the robot's pose at the exposure is known; on an arm, anywhere in the image."""
        entry = self.rig.book[frame.camera]
        light = self.rig.light_position(frame.stamp_ns) if light is None else light
        if light is None:
            return None
        radii = self.rig.settings.region
        radius = radii.calibrated if entry.calibrated else radii.nominal
        if entry.parent != "world":
            try:
                rotation, origin = self.rig.mounts.at(entry.parent, [frame.stamp_ns])
            except StateError:
                return None
            light, radius = rotation.T @ (light - origin), float(np.hypot(entry.model.width, entry.model.height))
        uv = entry.model.project(light)
        if not bool(entry.model.contains(uv, margin=-radius)):
            return None
        return SearchDisc(float(uv[0]), float(uv[1]), radius)


@dataclass(frozen=True)
class StereoFinding:
    """Finding of a light by two cameras.

    Attributes:
        point: Where it is in the world, None if that cannot be said.
        cause: Why not, one clause; empty if it can.
        epipolar_px: Distance of the spots from each other's epipolar lines [px]; NaN without a pair of spots.
        spots: The candidate of each camera that was chosen; None if there was none.
    """

    point: Point | None
    cause: str
    epipolar_px: float
    spots: tuple[SpotFit | None, SpotFit | None]


class ToolTriangulate(Tool):
    """Tool for a point: chooses the best matching pair of candidates, and triangulates; without a Vision Module."""

    name: ClassVar[str] = "tool_triangulate"

    def __call__(self, cameras: tuple[str, str], findings: tuple[SpotFinding, SpotFinding]) -> StereoFinding:
        """The light's place in the world.

        Args:
            cameras: Names of two cameras that are fixed to the world.
            findings: What each saw.
        """
        models = self.rig.book[cameras[0]].model, self.rig.book[cameras[1]].model
        both = product(findings[0].candidates, findings[1].candidates)
        pairs = [(*self._distance(models, pair), pair) for pair in both]
        if not pairs:
            causes = [f"{c}: {f.cause}" for c, f in zip(cameras, findings, strict=True) if not f.candidates]
            spots = (findings[0].spot, findings[1].spot)
            return StereoFinding(None, "; ".join(causes), float("nan"), spots)
        distance, fault, chosen = min(pairs, key=lambda scored: scored[0])
        nominal = [camera for camera in cameras if not self.rig.book[camera].calibrated]
        if nominal:
            cause = f"no point from cameras that are not calibrated: {', '.join(nominal)}"
            return StereoFinding(None, cause, distance, chosen)
        limit = self.rig.settings.stereo.epipolar
        if not distance <= limit:
            cause = fault or (
                f"the spots are {distance:.1f} px off each other's epipolar lines, at most {limit:g} are allowed: "
                "they are of different lights, or a camera was moved"
            )
            return StereoFinding(None, cause, distance, chosen)
        try:
            known = self.rig.book.covariance.of(cameras)
            point = triangulate(models, [np.array([s.u, s.v]) for s in chosen], [s.covariance for s in chosen], known)
        except DataError as error:
            return StereoFinding(None, error.message, distance, chosen)
        return StereoFinding(point, "", distance, chosen)

    @staticmethod
    def _distance(models: tuple[CameraModel, CameraModel], pair: tuple[SpotFit, SpotFit]) -> tuple[float, str]:
        """Distance from each other's epipolar lines [px], or infinite and why."""
        try:
            return epipolar_distance(*models, [np.array([spot.u, spot.v]) for spot in pair]), ""
        except DataError as error:  # a lens model that does not hold at a spot
            return float("inf"), error.message
