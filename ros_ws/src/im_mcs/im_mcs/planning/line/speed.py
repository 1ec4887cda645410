"""Motion of a path's parameter, time-optimal and jerk-limited: the fastest within all joint limits."""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.line.curve import JointCurves
from im_mcs.planning.trajectories.profile import along, transition_distance

_SHORTEST_S = 1e-7
_SHORTEST_M = 1e-9
# Step by which a speed is lowered that a stretch is too short for.
_SLOWER = 0.97
_SAMPLE_S = 0.01
_SAMPLES = 200
_GRID = 65
_TINY = 1e-9
# where polynomials meet, third derivatives jump: both sides count
_ASIDE_M = 1e-8
_ROUNDS, _HALVINGS = 40, 40
# Share of the limits that is used: what lies between the samples may be a little more.
_SHARE = 0.995
# Bounds are lowered by a little more than the excess, so that few rounds are needed.
_FURTHER = 1.002


@dataclass(frozen=True)
class Bounds:
    """Limits of the path parameter's motion: [m/s], [m/s2], [m/s3]."""

    velocity: float
    acceleration: float
    jerk: float

    def times(self, velocity: float = 1.0, acceleration: float = 1.0, jerk: float = 1.0) -> Self:
        """Each multiplied by a factor."""
        return type(self)(self.velocity * velocity, self.acceleration * acceleration, self.jerk * jerk)


@dataclass(frozen=True)
class Motion:
    """Path parameter at some times, each of shape (m,); jerk from the phase before the time.

    Attributes:
        t: Times [s].
        s: Path parameter [m].
        v: [m/s].
        a: [m/s2].
        j: [m/s3].
    """

    t: NDArray[np.float64]
    s: NDArray[np.float64]
    v: NDArray[np.float64]
    a: NDArray[np.float64]
    j: NDArray[np.float64]


class Profile:
    """Time-optimal motion of the path parameter from 0 to ``size``, at rest at both ends.

    Rounded corners are passed at a constant speed each.

    Attributes:
        duration: [s].

    Args:
        size: Of the path [m].
        bounds: Limits.
        corners: Begin and end of each rounded corner [m].
        speeds: Wanted in each of them; it is slower where the line before or after is too short for it [m/s].

    Raises:
        DataError: Ruckig finds no motion.
    """

    def __init__(
        self, size: float, bounds: Bounds, corners: Sequence[tuple[float, float]] = (), speeds: Sequence[float] = ()
    ) -> None:
        limits = (bounds.velocity, bounds.acceleration, bounds.jerk)
        begins = [0.0, *(end for _, end in corners)]
        ends = [*(begin for begin, _ in corners), size]
        gaps = [end - begin for begin, end in zip(begins, ends, strict=True)]
        passing = _passable(gaps, [0.0, *(min(speed, bounds.velocity) for speed in speeds), 0.0], bounds)
        self._lengths: list[float] = []
        parts = []
        for k, gap in enumerate(gaps):
            if gap > _SHORTEST_M:
                lengths, coefficients = along(gap, (passing[k], passing[k + 1]), limits)
                coefficients = coefficients.copy()
                coefficients[:, 0] += begins[k]
                self._lengths += lengths
                parts.append(coefficients)
            if k < len(corners):
                self._lengths.append((corners[k][1] - corners[k][0]) / passing[k + 1])
                parts.append(np.array([[corners[k][0], passing[k + 1], 0.0, 0.0, 0.0, 0.0]]))
        self._coefficients = np.concatenate(parts)
        self.duration = sum(self._lengths)

    def sampled(self, step: float, stops: Sequence[float] = (), way: float = math.inf) -> Motion:
        """Motion at the ends of all phases, when the path is at ``stops``, and between.

        Args:
            step: As close in time as this [s],
            way: or, where that is fewer, as close on the path [m]: what is slow does not need more places for that.
            stops: Path parameters between 0 and ``size`` [m].
        """
        lengths, c = np.array(self._lengths), self._coefficients[:, :4]
        begins = np.cumsum(lengths) - lengths
        ways = lengths * (c[:, 1] + lengths * (c[:, 2] + lengths * c[:, 3]))
        counts = np.maximum(np.ceil(np.minimum(lengths / step, ways / way)), 1.0).astype(np.intp)
        rank = np.repeat(np.arange(len(counts)), counts)
        within = np.arange(1, len(rank) + 1) - np.repeat(np.cumsum(counts) - counts, counts)
        met, x = _reached(c, lengths, np.array(stops))
        rank, x = np.append(rank, met), np.append(within * (lengths / counts)[rank], x)
        order = np.argsort(begins[rank] + x, kind="stable")
        rank, x = rank[order], x[order]
        c0, c1, c2, c3 = c[rank].T
        s, v = c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2.0 * c2 + x * 3.0 * c3)
        motion = np.stack([begins[rank] + x, s, v, 2.0 * c2 + x * 6.0 * c3, 6.0 * c3])
        motion = np.concatenate([np.zeros((5, 1)), motion], axis=1)
        return Motion(*motion[:, np.append(np.diff(motion[0]) > _SHORTEST_S, True)])


def _passable(gaps: Sequence[float], speeds: list[float], bounds: Bounds) -> list[float]:
    """Return speeds at the ends of stretches, with enough length for the change between the speeds."""
    passing = list(speeds)
    last = len(gaps) - 1
    for k, ahead in [*((k, True) for k in range(last + 1)), *((last - k, False) for k in range(last + 1))]:
        slow, fast = (k, k + 1) if ahead else (k + 1, k)
        while passing[fast] > passing[slow]:
            way = transition_distance(passing[slow], passing[fast], bounds.acceleration, bounds.jerk)
            if way <= gaps[k]:
                break
            passing[fast] = max(passing[slow], passing[fast] * _SLOWER)
    return passing


def _reached(
    c: NDArray[np.float64], lengths: NDArray[np.float64], places: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return phase and time within the phase for reaching places, by halving; not at the ends of phases.

    Args:
        c: Ascending powers of the time since each phase began, shape (m, 4).
        lengths: Of the phases, shape (m,) [s].
        places: Path parameters [m].
    """
    phase = np.clip(np.searchsorted(c[:, 0], places, side="right") - 1, 0, len(c) - 1)
    c0, c1, c2, c3 = c[phase].T
    low, high = np.zeros(len(places)), lengths[phase]
    for _ in range(_HALVINGS):
        x = (low + high) / 2.0
        before = c0 + x * (c1 + x * (c2 + x * c3)) < places
        low, high = np.where(before, x, low), np.where(before, high, x)
    inside = np.minimum(high, lengths[phase] - high) > _SHORTEST_S
    return phase[inside], high[inside]


def fit(
    curve: JointCurves, size: float, limits: MotionLimits, speed: float, corners: Sequence[tuple[float, float]]
) -> Generator[None, None, Profile]:
    """Find a profile within all limits, one round a step.

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
    for slope in (slopes.max(axis=0), np.median(slopes, axis=0)):  # a narrow place may be passed slowly anyway
        bounds = Bounds(
            min(speed, float((limits.velocity / slope).min())),
            float((limits.acceleration / slope).min()),
            float((limits.jerk / slope).min()),
        )
        speeds = [bounds.velocity] * len(corners)
        for _ in range(_ROUNDS):
            profile = Profile(size, bounds, corners, speeds)
            yield
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
    """Demands of a motion of the path parameter on the joints, term by term."""

    def __init__(self, curve: JointCurves, motion: Motion, limits: MotionLimits) -> None:
        self._s = np.concatenate([motion.s - _ASIDE_M, motion.s + _ASIDE_M])
        _, d1, d2, d3 = curve.at(np.clip(self._s, 0.0, motion.s[-1]))
        v, a = (np.tile(x, 2)[:, None] for x in (motion.v, motion.a))
        j = np.concatenate([motion.j, motion.j[1:], motion.j[-1:]])[:, None]
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
        """Return factors to lower velocity, acceleration and jerk; all 1 if limits are kept."""
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
