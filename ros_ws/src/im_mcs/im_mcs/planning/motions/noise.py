"""Recorded positions: noise of encoders in them is beyond every limit of jerk, and is no part of the motion.

The positions are averaged over time, as a diffusion does (J. J. Koenderink, "The structure of images", 1984: a Gaussian
is the only average that adds no turn of its own), over the shortest span by which the motion keeps its limits, or as
far as the positions may be off.
"""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.checks.envelope import excess
from im_mcs.planning.trajectories.interpolation import smooth, solve_tridiagonal
from im_mcs.planning.trajectories.polynomial import quintic

Array = NDArray[np.float64]

# share of the points at which the jerk of noise changes sign, beyond the limit on both sides
_ALTERNATING = 0.1
_PASSES = 4
# spans: the first and the longest, as standard deviations, and by how much each is longer than the one before
_FIRST_STEPS, _LONGEST_S, _LONGER = 0.7, 0.25, 1.4


def is_noisy(times: Array, q: Array, limits: MotionLimits) -> bool:
    """Return whether some joint's jerk goes to and fro beyond its limit, from point to point.

    Args:
        times: Strictly increasing, shape (m,) [s].
        q: Positions, shape (m, n).
        limits: Of the joints.
    """
    h = np.diff(times)[:, None]
    slope = np.diff(q, axis=0) / h
    force = 2.0 * np.diff(slope, axis=0) / (h[1:] + h[:-1])
    jerk = np.diff(force, axis=0) / h[1:-1]
    if len(jerk) < 1.0 / _ALTERNATING:
        return False
    sign = np.sign(jerk) * (np.abs(jerk) > limits.jerk)
    return bool(((sign[1:] * sign[:-1] < 0.0).mean(axis=0) > _ALTERNATING).any())


def smoothed(times: Array, q: Array, limits: MotionLimits, bound: Array) -> Generator[None, None, Array]:
    """Return positions without noise, shape (m, n), of a motion between two rests; both ends stay.

    Args:
        times: Strictly increasing, from 0, shape (m,) [s].
        q: Positions, shape (m, n).
        limits: To be kept, if that is possible within the bound.
        bound: How far each joint may be off a position, shape (n,) [rad or m].
    """
    h = np.diff(times)
    span, best = _FIRST_STEPS * float(np.median(h)), q
    while span <= _LONGEST_S:
        found = yield from _averaged(times, q, span)
        if (np.abs(found - q) > bound).any():
            break
        best = found
        zero = np.zeros(q.shape[1])
        ways = quintic(h, found, *smooth(h, found, zero, zero))
        if excess(ways, h, limits).max() <= 1.0:
            break
        span *= _LONGER
        yield
    return best


def _averaged(times: Array, q: Array, span: float) -> Generator[None, None, Array]:
    """Average over a span, as a standard deviation [s]; the motion is as if reflected at both rests."""
    h = np.diff(times)
    share = span**2 / (2.0 * _PASSES)
    wide = np.concatenate([h[:1], (h[1:] + h[:-1]) / 2.0, h[-1:]])
    after, before = -share / (h * wide[:-1]), -share / (h * wide[1:])
    after[0], before[-1] = 2.0 * after[0], 2.0 * before[-1]
    middle = 1.0 - np.append(after, 0.0) - np.append(0.0, before)
    found = q
    for _ in range(_PASSES):
        found = solve_tridiagonal(before, middle, after, found)
        yield
    x = (times / times[-1])[:, None]
    first, last = found[0] - q[0], found[-1] - q[-1]
    return np.asarray(found - first - (last - first) * x**3 * (10.0 - 15.0 * x + 6.0 * x**2))
