"""What OpenCV reaches on the same data: ``calibrateCamera`` for each camera by itself, plain and after RANSAC."""

import cv2
import numpy as np
from numpy.typing import NDArray

from im_calibration.problem.problem import CalibrationProblem
from im_cell.camera_model import CameraModel
from im_core.errors import DataError

Array = NDArray[np.float64]

_TRIM_ROUNDS = 10
_TRIM = 3.0
_ITERATIONS, _EPSILON = 200, 1e-12


def opencv_cameras(problem: CalibrationProblem, guess: CameraModel, *, trim: bool) -> tuple[CameraModel, ...] | None:
    """Calibrate each camera with 8 intrinsics from the measured positions; covariances and offsets are unknown to it.

    Args:
        problem: The observations.
        guess: Intrinsics to start from; those of the truth are the strongest opponent.
        trim: Whether to select spots by ``solvePnPRansac`` and then trim beyond 3 robust standard deviations.

    Returns:
        The cameras; None where OpenCV fails.
    """
    cameras = []
    for c in range(len(problem.camera_names)):
        seen = problem.detected[c]
        points, pixels = problem.positions[seen], problem.spots[c][seen]
        try:
            kept = _consensus(points, pixels, guess) if trim else np.ones(len(points), dtype=bool)
            camera, residuals = _calibrate(points, pixels, kept, guess)
            for _ in range(_TRIM_ROUNDS if trim else 0):
                lengths = np.linalg.norm(residuals, axis=1)
                limit = _TRIM * float(np.median(lengths[kept])) / 1.1774  # median of a Rayleigh distribution
                again = lengths < limit
                if np.array_equal(again, kept) or again.sum() < 8:
                    break
                kept = again
                camera, residuals = _calibrate(points, pixels, kept, guess)
        except (cv2.error, DataError):
            return None
        cameras.append(camera)
    return tuple(cameras)


def _consensus(points: Array, pixels: Array, guess: CameraModel) -> NDArray[np.bool_]:
    cv2.setRNGSeed(1)
    found, _, _, inliers = cv2.solvePnPRansac(
        points, pixels, guess.K, guess.D, iterationsCount=500, reprojectionError=8.0, flags=cv2.SOLVEPNP_EPNP
    )
    kept = np.zeros(len(points), dtype=bool)
    if found and inliers is not None and len(inliers) >= 8:
        kept[inliers.ravel()] = True
    else:
        kept[:] = True
    return kept


def _calibrate(points: Array, pixels: Array, kept: NDArray[np.bool_], guess: CameraModel) -> tuple[CameraModel, Array]:
    _, K, D, rotations, translations = cv2.calibrateCamera(
        [points[kept].astype(np.float32)],
        [pixels[kept].astype(np.float32)],
        (guess.width, guess.height),
        guess.K.copy(),
        guess.D.copy(),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _ITERATIONS, _EPSILON),
    )
    rotation = np.array(cv2.Rodrigues(rotations[0])[0], dtype=float)
    matrix, lens, translation = (np.array(value, dtype=float) for value in (K, D.ravel()[:5], translations[0].ravel()))
    camera = CameraModel(guess.width, guess.height, matrix, lens, rotation, translation)
    return camera, pixels - camera.project(points)
