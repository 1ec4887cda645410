"""The fastest motion along a path with which no joint passes its limits."""

from collections.abc import Generator, Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.planning.line_joints import JointCurve
from im_mcs.planning.line_profile import Bounds, Motion, Profile
from im_mcs.planning.motion_limits import MotionLimits

_SAMPLE_S = 0.01
_SAMPLES = 200
_GRID = 65
_TINY = 1e-9
_ROUNDS = 40
# Share of the limits that is used: what lies between the samples may be a little more.
_SHARE = 0.995
# Bounds are lowered by a little more than the excess, so that few rounds are needed.
_FURTHER = 1.002


def fit(
    curve: JointCurve, size: float, limits: MotionLimits, speed: float, corners: Sequence[tuple[float, float]]
) -> Generator[None, None, Profile]:
    """Find a profile that keeps all limits, one round a step.

    In every round the bounds of the path parameter (velocity, acceleration, jerk) that contribute most to the worst
    excess on the lines are lowered, and the speed of every rounded corner with an excess. The first bounds are once
    those of the worst place of the path, once those of its common run, lest a narrow place that is passed slowly
    anyway slows down all the rest; the faster result counts.

    Args:
        curve: Joint positions over the path parameter.
        size: Of the path [m].
        limits: Of the joints, each of shape (n,).
        speed: Largest velocity of the path parameter [m/s].
        corners: Begin and end of each rounded corner [m].

    Raises:
        DataError: No profile was found.
    """
    slopes = np.abs(curve.at(np.linspace(0.0, size, _GRID))[1]) + _TINY
    yield
    best: Profile | None = None
    for slope in (slopes.max(axis=0), np.median(slopes, axis=0)):
        bounds = Bounds(
            min(speed, float((limits.velocity / slope).min())),
            float((limits.acceleration / slope).min()),
            float((limits.jerk / slope).min()),
        )
        speeds = [bounds.velocity] * len(corners)
        for _ in range(_ROUNDS):
            profile = Profile(size, bounds, corners, speeds)
            samples = profile.sampled(max(_SAMPLE_S, profile.duration / _SAMPLES))
            yield
            motion = Terms(curve, samples, limits)
            yield
            slower = [motion.corner(*corner) for corner in corners]
            factors = motion.lines(corners)
            if min(*factors, *slower) == 1.0:
                if best is None or profile.duration < best.duration:
                    best = profile
                break
            bounds = bounds.times(*factors)
            speeds = [min(speed, bounds.velocity) * factor for speed, factor in zip(speeds, slower, strict=True)]
    if best is None:
        raise DataError(f"no speed along the path of {size:.4g} m was found that keeps all joint limits")
    return best


class Terms:
    """What a motion of the path parameter asks of the joints, term by term.

    Args:
        curve: Joint positions over the path parameter.
        motion: The path parameter at some times.
        limits: Of the joints.
    """

    def __init__(self, curve: JointCurve, motion: Motion, limits: MotionLimits) -> None:
        _, d1, d2, d3 = curve.at(motion.s)
        v, a, j = motion.v[:, None], motion.a[:, None], motion.j[:, None]
        self._s = motion.s
        self._velocity = d1 * v / (limits.velocity * _SHARE)
        self._acceleration = np.stack([d2 * v * v, d1 * a]) / (limits.acceleration * _SHARE)
        self._jerk = np.stack([d3 * v**3, 3.0 * d2 * v * a, d1 * j]) / (limits.jerk * _SHARE)

    def corner(self, begin: float, end: float) -> float:
        """Factor by which to lower the speed in a rounded corner; 1 if limits are kept."""
        inside = (self._s >= begin) & (self._s <= end)
        if not inside.any():
            return 1.0
        velocity, _ = _worst(self._velocity[inside])
        acceleration, _ = _worst(self._acceleration[0, inside])
        jerk, _ = _worst(self._jerk[0, inside])
        return float(min(1.0 / velocity, acceleration**-0.5, jerk ** (-1.0 / 3.0)))

    def lines(self, corners: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
        """Factors by which to lower velocity, acceleration and jerk on all else; all 1 if limits are kept."""
        outside = np.ones(len(self._s), dtype=np.bool_)
        for begin, end in corners:
            outside &= (self._s < begin) | (self._s > end)
        velocity, acceleration, jerk = 1.0 / _worst(self._velocity[outside])[0], 1.0, 1.0
        terms = self._acceleration[:, outside]
        excess, at = _worst(terms.sum(axis=0))
        if abs(terms[0][at]) > abs(terms[1][at]):
            velocity = min(velocity, excess**-0.5)
        else:
            acceleration /= excess
        terms = self._jerk[:, outside]
        excess, at = _worst(terms.sum(axis=0))
        match int(np.argmax([abs(term[at]) for term in terms])):
            case 0:
                velocity = min(velocity, excess ** (-1.0 / 3.0))
            case 1:
                velocity, acceleration = min(velocity, excess**-0.5), min(acceleration, excess**-0.5)
            case _:
                jerk /= excess
        return velocity, acceleration, jerk


def _worst(shares: NDArray[np.float64]) -> tuple[float, tuple[np.intp, ...]]:
    """By which factor shares of limits, shape (m, n), are beyond 1 at the worst, 1 if none is, and where."""
    size = np.abs(shares)
    at = np.unravel_index(int(size.argmax()), size.shape)
    worst = float(size[at])
    return (worst * _FURTHER if worst > 1.0 else 1.0), at
