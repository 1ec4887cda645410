"""Fiducial plates in an image."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from im_core.camera_model import CameraModel, distort
from im_core.errors import DataError
from im_core.robot.scenery import Target
from im_vss.edges.band import Image
from im_vss.fiducial.corners import refine_corners
from im_vss.fiducial.dictionary import CELLS, DICTIONARY
from im_vss.fiducial.pose import PlatePose, plate_poses
from im_vss.spot import SensorNoise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FiducialFit:
    """A plate: the target of the cell, its pose, its corners in the image, shape (4, 2) [px].

    Attributes:
        target: Which one.
        pose: Where it is in the optical frame.
        corners: Upper left first, clockwise as printed, shape (4, 2) [px].
        ambiguity: Reprojection error of this pose over that of the mirrored one, 0 to 1.
    """

    target: Target
    pose: PlatePose
    corners: Array
    ambiguity: float


def find_fiducials(
    image: Image, camera: CameraModel, noise: SensorNoise, wanted: Mapping[int, Target]
) -> tuple[list[FiducialFit], dict[int, str]]:
    """Find plates in an image.

    Args:
        image: Pixels, shape (h, w) [DN].
        camera: Intrinsics and lens.
        noise: Noise of the sensor.
        wanted: Plates by number of their code.

    Returns:
        What was found, by number, and for each of the others why it was not.
    """
    found: list[FiducialFit] = []
    missed = dict.fromkeys(wanted, "not seen: it is out of view, hidden or too small")
    quads, numbers, _ = cv2.aruco.ArucoDetector(DICTIONARY).detectMarkers(image)
    for quad, number in zip(quads, [] if numbers is None else numbers.ravel(), strict=True):
        target = wanted.get(int(number))
        if target is None or target.id not in missed:
            continue
        try:
            corners = refine_corners(image, camera, quad.reshape(4, 2).astype(float), CELLS, noise)
        except DataError as error:
            missed[target.id] = error.message
            continue
        poses = plate_poses(corners, camera.K, target.size) if corners is not None else []
        if corners is None or not poses:
            missed[target.id] = "seen, but its edges are not straight or not clear enough"
            continue
        ideal = (corners.uv - camera.K[:2, 2]) @ np.linalg.inv(camera.K[:2, :2]).T
        ambiguity = float(np.sqrt(poses[0].chi2 / max(poses[1].chi2, 1e-12))) if len(poses) > 1 else 0.0
        found.append(FiducialFit(target, poses[0], camera.to_pixels(distort(ideal, camera.D)), ambiguity))
        del missed[target.id]
    return sorted(found, key=lambda fit: fit.target.id), missed
