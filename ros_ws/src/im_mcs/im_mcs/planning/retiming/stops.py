"""Places of rest on a requested trajectory, including sharp turns."""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.retiming.asked_path import CHUNK, AskedPath
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, powers_to_jerk

Array = NDArray[np.float64]

_STILL = 1e-9
# a path that turns by sixty degrees and more within such times, where it is slowest, is not run through but stopped in
_TURN_S = (0.02, 0.004, 1e-3, 1e-4, 1e-5)
_SHARP = 0.5
_STEPS = 8
SAME_S = 5e-10
"""Asked times that differ by less are the same: half of what messages resolve, for corners that are cut round [s]."""


def standing(trajectory: PiecewisePolynomial, unit: Array) -> Generator[None, None, NDArray[np.bool_]]:
    """Return the pieces without motion, shape (m,); ``unit`` is the velocity of each joint counted as 1."""
    still = np.empty(len(trajectory.lengths), dtype=np.bool_)
    for k in range(0, len(still), CHUNK):
        some = slice(k, k + CHUNK)
        ways = trajectory.coefficients[some, 1:] * trajectory.lengths[some, None, None] ** np.arange(1, 6)[:, None]
        still[some] = (np.abs(ways) <= _STILL * unit).all(axis=(1, 2))
        yield
    return still


def rests(trajectory: PiecewisePolynomial, path: AskedPath, unit: Array) -> Generator[None, None, Array]:
    """Asked times between which a trajectory is re-timed stretch by stretch, both ends included, shape (m,) [s].

    Args:
        trajectory: Asked.
        path: The whole of it.
        unit: Velocity of each joint that counts as 1, shape (n,).
    """
    speed = np.append(path.speed[0], path.speed[1, -1])
    inner = speed[1:-1]
    lowest = 1 + np.flatnonzero((inner <= speed[:-2]) & (inner <= speed[2:]))
    still = yield from standing(trajectory, unit)
    borders = np.flatnonzero(still[1:] != still[:-1]) + 1
    found = [0.0, trajectory.duration, *trajectory.edges[borders].tolist()]
    yield
    for k in range(0, len(lowest), CHUNK):
        some = lowest[k : k + CHUNK]
        tau = _slowest(trajectory, path.tau[some - 1], path.tau[some], path.tau[some + 1], unit)
        yield
        stops = (_way(trajectory, tau, unit) ** 2).sum(axis=1) <= _STILL**2
        for off in _TURN_S:
            stops |= _turned(_way(trajectory, tau - off, unit), _way(trajectory, tau + off, unit))
        found += tau[stops].tolist()
        yield
    for k in range(0, len(path.piece), 10 * CHUNK):
        cells = slice(k, k + 10 * CHUNK)
        sharp = k + np.flatnonzero(_turned(path.first[cells] / unit, path.last[cells] / unit))
        found += path.tau[sharp + (speed[sharp + 1] < speed[sharp])].tolist()
        yield
    times = np.unique(found)
    yield
    edges = np.append(trajectory.edges, trajectory.duration)
    nearest = edges[np.clip(np.searchsorted(edges, times - SAME_S), 0, len(edges) - 1)]
    times = np.unique(np.where(np.abs(nearest - times) <= SAME_S, nearest, times))
    times = times[np.append(True, np.diff(times) > SAME_S)]
    return np.asarray(times[~_within(times, trajectory, still)])


def _turned(before: Array, after: Array) -> NDArray[np.bool_]:
    """Return the places with two directions, shape (m, n) each, far apart; a standing one has none."""
    size = np.sqrt((before**2).sum(axis=1) * (after**2).sum(axis=1))
    return np.asarray(((before * after).sum(axis=1) < _SHARP * size) & (size > _STILL**2))


def _within(times: Array, trajectory: PiecewisePolynomial, still: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the times within standing pieces, ends excluded."""
    piece = np.clip(np.searchsorted(trajectory.edges, times, side="right") - 1, 0, len(still) - 1)
    inside = still[piece] & still[np.maximum(piece - 1, 0)]
    inside[[0, -1]] = False
    at_edge = times == trajectory.edges[piece]
    return np.asarray((still[piece] & ~at_edge | inside & at_edge) & (times > 0.0) & (times < trajectory.duration))


def _slowest(trajectory: PiecewisePolynomial, low: Array, middle: Array, high: Array, unit: Array) -> Array:
    """Return times of the smallest speeds from ``low`` to ``high``: Newton's method from ``middle`` within cells."""
    best, least = middle.copy(), (_way(trajectory, middle, unit) ** 2).sum(axis=1)
    for begin, end in ((low, middle), (middle, high)):
        tau, inside = (begin + end) / 2.0, (begin + end) / 2.0
        piece = np.clip(np.searchsorted(trajectory.edges, inside, side="right") - 1, 0, None)
        for _ in range(_STEPS):
            values = powers_to_jerk(tau - trajectory.edges[piece]) @ trajectory.coefficients[piece] / unit
            v, a, j = values[:, 1], values[:, 2], values[:, 3]
            slope, bend = (v * a).sum(axis=1), (a * a + v * j).sum(axis=1)
            tau = np.clip(tau - slope / np.where(np.abs(bend) > 0.0, np.abs(bend), 1.0), begin, end)
        v = (powers_to_jerk(tau - trajectory.edges[piece]) @ trajectory.coefficients[piece] / unit)[:, 1]
        size = (v * v).sum(axis=1)
        best, least = np.where(size < least, tau, best), np.minimum(size, least)
    return best


def _way(trajectory: PiecewisePolynomial, tau: Array, unit: Array) -> Array:
    tau = np.clip(tau, 0.0, trajectory.duration)
    piece = np.clip(np.searchsorted(trajectory.edges, tau, side="right") - 1, 0, None)
    values = powers_to_jerk(tau - trajectory.edges[piece]) @ trajectory.coefficients[piece]
    return np.asarray(values[:, 1] / unit)
