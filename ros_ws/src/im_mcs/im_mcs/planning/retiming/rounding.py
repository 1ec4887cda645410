"""Rounding of places with a jump of curvature, as cubics in a row have at the points.

No motion follows such a place but at rest: across the path the acceleration would jump. A quintic with the states of
both sides takes the place of what lies ``x`` seconds around; it is off the path by less than ``jump x^2 / 93``, with
``jump`` the part of the acceleration's jump that points across the path.
"""

from collections.abc import Generator
from math import comb

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, powers, quintic

Array = NDArray[np.float64]

_OFF = 93.0
# share of the shorter neighbour that is replaced at most, and jumps, as shares of the limit, that do not matter
_SHARE = 0.4
_NO_JUMP = 1e-4
_STILL = 1e-9
_PIECES = 100
_SHIFT = np.array([[comb(p, r) for p in range(6)] for r in range(6)], dtype=np.float64)
_TINY = 1e-100


def rounded(
    trajectory: PiecewisePolynomial, acceleration: Array, velocity: Array, depth: Array
) -> Generator[None, None, PiecewisePolynomial]:
    """The same trajectory, in the same time, with rounded changes of curvature; some pieces a slice.

    Args:
        trajectory: Continuous to velocity.
        acceleration: Limits, shape (n,).
        velocity: Limits, shape (n,).
        depth: How far each joint may be off, shape (n,) [rad or m].
    """
    c, h = trajectory.coefficients, trajectory.lengths
    widths = np.zeros(len(h) + 1)
    for k in range(0, len(h) - 1, _PIECES):
        left = slice(k, min(k + _PIECES, len(h) - 1))
        ends = powers(h[left])[:, 1:] @ c[left]
        jump = 2.0 * c[left.start + 1 : left.stop + 1, 2] - ends[:, 1]
        way = ends[:, 0] / velocity
        size = np.sqrt((way**2).sum(axis=1))[:, None]
        share = (way * (jump / velocity)).sum(axis=1)[:, None] / np.maximum(size, _TINY) ** 2
        across = np.abs(jump - share * ends[:, 0])
        width = np.sqrt(_OFF * depth / np.maximum(across, _TINY)).min(axis=1)
        width = np.minimum(width, _SHARE * np.minimum(h[left], h[left.start + 1 : left.stop + 1]))
        smooth = (across <= _NO_JUMP * acceleration).all(axis=1) | (size[:, 0] <= _STILL)
        widths[left.start + 1 : left.stop + 1] = np.where(smooth, 0.0, width)
        yield
    if not widths.any():
        return trajectory
    parts: list[Array] = []
    lengths: list[float] = []
    points: list[int] = []
    for k in range(0, len(h), _PIECES):
        _replace(trajectory, slice(k, min(k + _PIECES, len(h))), widths, (parts, lengths, points))
        yield
    return PiecewisePolynomial(lengths, np.concatenate(parts), points)


def _replace(
    trajectory: PiecewisePolynomial,
    some: slice,
    widths: Array,
    whole: tuple[list[Array], list[float], list[int]],
) -> None:
    """Return each piece without the rounded ends, followed by the quintic into the next piece."""
    c, h = trajectory.coefficients[some], trajectory.lengths[some]
    before, after = widths[some.start : some.stop], widths[some.start + 1 : some.stop + 1]
    shift = before[:, None, None] ** np.maximum(np.arange(6)[None, :] - np.arange(6)[:, None], 0)
    kept = (_SHIFT * shift) @ c
    turns = np.flatnonzero(after > 0.0)
    ends = np.empty((2 * len(turns), 3, c.shape[2]))
    ends[::2] = powers((h - after)[turns]) @ c[turns]
    ends[1::2] = powers(after[turns]) @ trajectory.coefficients[some.start + 1 + turns]
    steps = np.ones(max(2 * len(turns) - 1, 0))
    steps[::2] = 2.0 * after[turns]
    corners = quintic(steps, *ends.swapaxes(0, 1))[::2] if len(turns) else np.empty((0, *c.shape[1:]))
    order = np.concatenate([np.arange(len(h)), turns + 0.5]).argsort()
    points = np.array(trajectory.points[some])
    whole[0].append(np.concatenate([kept, corners])[order])
    whole[1].extend(np.concatenate([h - before - after, 2.0 * after[turns]])[order].tolist())
    whole[2].extend(np.concatenate([points, points[turns]])[order].tolist())
