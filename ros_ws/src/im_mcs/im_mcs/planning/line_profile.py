"""Motion of a path's parameter: time-optimal and jerk-limited between rests and rounded corners."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.profile import along, transition_distance

_SHORTEST_S = 1e-7
_SHORTEST_M = 1e-9
# Steps by which a speed is lowered that a stretch is too short for.
_SLOWER, _SLOWEST = 0.97, 1e-5


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
    """The path parameter at some times, each of shape (m,); jerk is that of the phase which the time ends.

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

    def sampled(self, step: float, stops: Sequence[float] = ()) -> Motion:
        """Motion at times ``step`` seconds apart at most, at the ends of all phases, and when the path is at ``stops``.

        Args:
            step: [s].
            stops: Path parameters between 0 and ``size`` [m].
        """
        parts, begin = [np.zeros((5, 1))], 0.0
        for length, (c0, c1, c2, c3) in zip(self._lengths, self._coefficients[:, :4], strict=True):
            x = np.linspace(0.0, length, math.ceil(length / step) + 1)[1:]
            met = [t for t in (_reached((c0, c1, c2, c3), length, stop) for stop in stops) if t is not None]
            x = np.unique(np.append(x, met))
            s, v = c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2.0 * c2 + x * 3.0 * c3)
            parts.append(np.stack([begin + x, s, v, 2.0 * c2 + x * 6.0 * c3, np.full(len(x), 6.0 * c3)]))
            begin += length
        motion = np.concatenate(parts, axis=1)
        return Motion(*motion[:, np.append(np.diff(motion[0]) > _SHORTEST_S, True)])


def _passable(gaps: Sequence[float], speeds: list[float], bounds: Bounds) -> list[float]:
    """Speeds at the ends of stretches that are long enough for the change between them."""
    passing = list(speeds)
    last = len(gaps) - 1
    for k, ahead in [*((k, True) for k in range(last + 1)), *((last - k, False) for k in range(last + 1))]:
        slow, fast = (k, k + 1) if ahead else (k + 1, k)
        while passing[fast] > passing[slow]:
            way = transition_distance(passing[slow], passing[fast], bounds.acceleration, bounds.jerk)
            if way <= gaps[k]:
                break
            passing[fast] = max(passing[slow], passing[fast] * _SLOWER - _SLOWEST)
    return passing


def _reached(c: tuple[float, float, float, float], length: float, place: float) -> float | None:
    """When a phase comes to a place, by halving; None: not within it, or at its very ends."""
    low, high = 0.0, length
    value = c[0] + length * (c[1] + length * (c[2] + length * c[3]))
    if not c[0] < place < value:
        return None
    for _ in range(40):
        x = (low + high) / 2.0
        if c[0] + x * (c[1] + x * (c[2] + x * c[3])) < place:
            low = x
        else:
            high = x
    return high if min(high, length - high) > _SHORTEST_S else None
