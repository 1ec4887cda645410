"""Tool that computes where in the world a light is."""

from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from im_cell.camera_model import CameraModel
from im_core.errors import DataError
from im_vss.spot import SpotFinding, SpotFit
from im_vss.stereo import Point, epipolar_distance, triangulate
from im_vss.tools.tool import Tool


@dataclass(frozen=True)
class StereoFinding:
    """What two cameras make of a light.

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
    """Chooses the pair of candidates that fit each other best, and triangulates; without a Vision Module."""

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
