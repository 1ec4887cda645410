"""Bad data sets, which must get the right verdict, and good ones, which must get none."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray

from bench.calibration.kinds import CLEAN, HARD
from bench.calibration.synthetic import Design, make_scene, random_rotations, with_stated_noise
from im_calibration.estimation.unknowns import rotation_exp
from im_calibration.judgement.verdicts import MISFIT, UNOBSERVABLE
from im_calibration.problem.problem import CalibrationProblem
from im_calibration.reporting.report import answer

Array = NDArray[np.float64]

_POSES = 40


@dataclass(frozen=True)
class Bad:
    """A kind of bad data: the verdict it must get, and how to make one from a seed."""

    verdict: str
    make: Callable[[int], CalibrationProblem]


def _plane(seed: int, thickness: float = 0.0) -> Array:
    rng = np.random.default_rng(seed)
    points = rng.uniform((-1.0, -0.5, -0.5), (1.0, 0.5, 0.5), (_POSES, 3))
    tilt = rng.uniform(-0.4, 0.4, 2)
    points[:, 2] = 1.1 + points[:, :2] @ tilt + thickness * points[:, 2]
    return points


def _line(seed: int) -> Array:
    along = np.random.default_rng(seed).uniform(-1.0, 1.0, (_POSES, 1))
    return np.asarray(np.array([0.0, 0.0, 1.1]) + along * np.array([0.9, 0.3, 0.3]))


def _corner(seed: int) -> Array:
    return np.random.default_rng(seed).uniform((-0.1, -0.1, 1.0), (0.1, 0.1, 1.2), (_POSES, 3))


def _one_axis(seed: int) -> Array:
    angles = np.random.default_rng(seed).uniform(-2.0, 2.0, _POSES)
    axis = np.eye(3)[seed % 3]
    return rotation_exp(angles[:, None] * axis)


def _same_wrist(seed: int) -> Array:
    return np.tile(random_rotations(np.random.default_rng(seed), 1), (_POSES, 1, 1))


def _of(design: Design, seed: int, positions: Array | None = None, wrists: Array | None = None) -> CalibrationProblem:
    return make_scene(design, seed, positions=positions, wrists=wrists).problem


def _camera_moved(seed: int, shift: float) -> CalibrationProblem:
    problem = _of(Design(), seed)
    spots = problem.spots.copy()
    angle = float(seed)
    spots[1, _POSES // 2 :] += shift * np.array([np.cos(angle), np.sin(angle)])
    return replace(problem, spots=spots)


def _one_noisy(seed: int) -> CalibrationProblem:
    problem = _of(Design(), seed)
    noise = problem.spot_covariances.copy()
    noise[1] /= 9.0
    return replace(problem, spot_covariances=noise)


def _base_moved(seed: int) -> CalibrationProblem:
    problem = _of(Design(), seed)
    positions = problem.positions.copy()
    positions[_POSES // 2 :] += 0.01 * random_rotations(np.random.default_rng(seed), 1)[0, 0]
    return replace(problem, positions=positions)


def _permuted(seed: int) -> CalibrationProblem:
    problem = _of(Design(), seed)
    return replace(problem, spots=problem.spots[:, np.random.default_rng(seed).permutation(_POSES)])


def _one_late(seed: int) -> CalibrationProblem:
    """One camera's images belong to the pose before."""
    problem = _of(Design(), seed)
    spots = problem.spots.copy()
    spots[1] = np.roll(spots[1], 1, axis=0)
    return replace(problem, spots=spots)


def _undeclared_joint_offsets(seed: int) -> CalibrationProblem:
    problem = _of(Design(joint_offset_prior_sd=5e-3), seed)
    return replace(problem, joint_offset_prior_sd=0.0, joint_jacobians=None)


BAD = {
    "positions in a plane": Bad(UNOBSERVABLE, lambda seed: _of(Design(), seed, _plane(seed))),
    "in a plane within 10 mm": Bad(UNOBSERVABLE, lambda seed: _of(Design(), seed, _plane(seed, 0.01))),
    "in a plane, 10 % outliers": Bad(UNOBSERVABLE, lambda seed: _of(Design(outlier_share=0.1), seed, _plane(seed))),
    "on a line": Bad(UNOBSERVABLE, lambda seed: _of(Design(), seed, _line(seed))),
    "in a corner": Bad(UNOBSERVABLE, lambda seed: _of(Design(), seed, _corner(seed))),
    "eight poses": Bad(UNOBSERVABLE, lambda seed: _of(Design(poses=8), seed)),
    "constant wrist, LED unknown": Bad(
        UNOBSERVABLE, lambda seed: _of(Design(led_offset_prior_sd=0.05), seed, wrists=_same_wrist(seed))
    ),
    "wrist about one axis, LED unknown": Bad(UNOBSERVABLE, lambda seed: _of(Design(), seed, wrists=_one_axis(seed))),
    "noise twice as large": Bad(MISFIT, lambda seed: with_stated_noise(_of(Design(), seed), 0.5)),
    "noise five times as large": Bad(MISFIT, lambda seed: with_stated_noise(_of(Design(), seed), 0.2)),
    "noise half as large again, outliers": Bad(
        MISFIT, lambda seed: with_stated_noise(_of(Design(outlier_share=0.1), seed), 1.0 / 1.5)
    ),
    "one camera three times as noisy": Bad(MISFIT, _one_noisy),
    "camera moved by 1 px": Bad(MISFIT, lambda seed: _camera_moved(seed, 1.0)),
    "camera moved by 30 px": Bad(MISFIT, lambda seed: _camera_moved(seed, 30.0)),
    "base moved by 10 mm": Bad(MISFIT, _base_moved),
    "spots of other poses": Bad(MISFIT, _permuted),
    "one camera a pose late": Bad(MISFIT, _one_late),
    "LED offset not as stated": Bad(
        MISFIT, lambda seed: replace(_of(Design(led_offset_prior_sd=0.01), seed), led_offset_prior_sd=0.0)
    ),
    "joint offsets not declared": Bad(MISFIT, _undeclared_joint_offsets),
    "robot 1 % too small, known lengths": Bad(MISFIT, lambda seed: _of(Design(scale_error=0.01, lengths=10), seed)),
}


def wrong_verdicts(seed: int, count: int = 60) -> Iterator[tuple[str, int, list[str]]]:
    """Bad sets, kind by kind in turn, that do not get exactly the verdict they should.

    Yields:
        Kind, seed, and the verdicts given.
    """
    for i, (name, bad) in enumerate(islice(cycle(BAD.items()), count)):
        flags = answer(bad.make(seed + i))["flags"]
        if flags != [bad.verdict]:
            yield name, seed + i, flags


def false_verdicts(seed: int, count: int = 500) -> Iterator[tuple[str, int, list[str]]]:
    """Good sets, kind by kind in turn, that get a verdict; as :func:`wrong_verdicts`."""
    for i, (name, design) in enumerate(islice(cycle((CLEAN | HARD).items()), count)):
        flags = answer(make_scene(design, seed + i).problem)["flags"]
        if flags:
            yield name, seed + i, flags
