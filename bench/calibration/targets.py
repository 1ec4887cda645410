"""Targets measured, ``python -m bench.calibration.targets [SEEDS]``: corners beside OpenCV's, coverage of each job."""

import sys
from collections.abc import Iterator
from itertools import chain

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.calibration.boards import Sensor, render
from bench.calibration.target_views import JOBS, errors_over_expected, make_views
from im_calibration.pipeline import calibrate
from im_calibration.problem.target_problem import problem_of_views
from im_calibration.targets.detection import detect
from im_calibration.targets.target import target_of
from im_cell.camera_model import CameraModel
from im_cell.rotations import matrix_of_vector

Array = NDArray[np.float64]

_CAMERA = CameraModel(
    480, 360, np.array([[450.0, 0.0, 242.0], [0.0, 452.0, 176.0], [0.0, 0.0, 1.0]]),
    np.array([-0.25, 0.08, 0.001, -0.0005, 0.0]),
)  # fmt: skip
_SENSORS = {
    "sharp": Sensor(),
    "blur 1.5 px, noise 2 %": Sensor(blur=1.5, noise=0.02),
    "gamma 2.2": Sensor(gamma=2.2),
}


def corners(seeds: int) -> Iterator[str]:
    """Yield lines on errors of corners of a chessboard [px], ours and OpenCV's two, and ours over the told noise."""
    target = target_of("chessboard:9x6:25mm")
    for name, sensor in _SENSORS.items():
        ours, sectors, saddles, ratios = (list[Array]() for _ in range(4))
        for seed in range(seeds):
            rng = np.random.default_rng((7, seed))
            rotation = matrix_of_vector(rng.normal(0.0, 0.3, 3))
            shift = np.array([*rng.uniform(-0.05, 0.05, 2), 0.5]) - rotation @ target.points.mean(axis=0)
            image = render(target, _CAMERA, rotation, shift, sensor, seed)
            truth = _CAMERA.project(target.points @ rotation.T + shift)
            found = detect(image, target)
            grey = np.asarray(image, dtype=np.uint8)
            size = (target.columns, target.rows)
            there, raw = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
            if found is None or not there:
                continue
            ours.append(found.points - truth)
            ratios.append(ours[-1] / found.standard_deviations[:, None])
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
            refined = cv2.cornerSubPix(grey, raw.copy(), (5, 5), (-1, -1), stop)
            for errors, points in ((sectors, raw), (saddles, refined)):
                errors.append(_nearest(np.reshape(np.asarray(points), (-1, 2)), truth))
        yield (
            f"| {name} | {_rms(ours):.3f} | {_rms(sectors):.3f} | {_rms(saddles):.3f} | {_rms(ratios):.2f} | "
            f"{len(ours)} of {seeds} |"
        )


def coverage(seeds: int) -> Iterator[str]:
    """Yield lines on each job: errors over expected ones, share of 95 % intervals that hold the truth, verdicts."""
    for job in JOBS:
        for unknown in ((), ("image", "robot")):
            ratios, verdicts = [], 0
            for seed in range(seeds):
                true = make_views(job, seed)
                found = calibrate(problem_of_views(true.views, unknown))
                ratios.append(errors_over_expected(found, true))
                verdicts += not found.success
            all_of = np.array(ratios)
            noise = "estimated" if unknown else "stated"
            yield (
                f"| {job}, noise {noise} | {np.sqrt(np.mean(all_of**2)):.2f} | "
                f"{100.0 * np.mean(np.abs(all_of) < 1.96):.1f} % | {verdicts} of {seeds} |"
            )


def _nearest(points: Array, truth: Array) -> Array:
    """Return the offsets of points from the nearest true ones, for detectors that count otherwise, shape (p, 2)."""
    apart = points[:, None] - truth[None]
    return np.asarray(apart[np.arange(len(points)), np.linalg.norm(apart, axis=2).argmin(axis=1)])


def _rms(errors: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("nan")


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    for line in chain(corners(count), coverage(count)):
        print(line, flush=True)
