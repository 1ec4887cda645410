"""Whether poses chosen by expected error beat poses chosen by chance, in the errors that are then achieved."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bench.calibration.score import errors
from bench.calibration.synthetic import Design, make_scene
from im_calibration.design import Candidates, next_best_poses
from im_calibration.pipeline import calibrate
from im_cell.calibration_error import rms

_FIRST, _POOL = 12, 150


@dataclass(frozen=True)
class Achieved:
    """RMS triangulation errors over trials [mm].

    Attributes:
        before: With the first poses alone.
        chosen: With further poses by expected error.
        random: With as many by chance.
        predicted: What the choice expected of itself.
    """

    before: float
    chosen: float
    random: float
    predicted: float


def further_poses(seeds: Iterable[int], count: int = 6) -> Achieved:
    """Calibrate from 12 poses, add some of 150 others, calibrate again."""
    found: list[tuple[float, float, float, float]] = []
    for seed in seeds:
        scene = make_scene(Design(poses=_FIRST + _POOL), seed)
        whole, first = scene.problem, np.arange(_FIRST)
        pool = whole.taking(np.arange(_FIRST, _FIRST + _POOL))
        start = calibrate(whole.taking(first))
        candidates = Candidates(
            pool.pose_names, pool.positions, pool.position_covariances, pool.wrist_rotations, pool.spot_covariances
        )
        best = next_best_poses(start, whole.taking(first), candidates, count)
        sets = (
            first,
            np.append(first, [_FIRST + pose.index for pose in best]),
            np.append(first, _FIRST + np.random.default_rng(seed).permutation(_POOL)[:count]),
        )
        models = [tuple(camera.model for camera in calibrate(whole.taking(poses)).cameras) for poses in sets]
        before, chosen, random = (errors(cameras, scene)[1] for cameras in models)
        found.append((before, chosen, random, best[-1].triangulation_mm[1]))
    return Achieved(*(rms(column) for column in np.array(found).T))
