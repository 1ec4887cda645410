"""Braking on a straight stretch of a path: as fast as limits allow, and exactly on the path.

On a straight stretch the time-optimal deceleration of all joints together runs along it, so that no ramp of the rate
has to be sought; what remains is to find out where on the trajectory it ends.
"""

import math

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.profile import ramp
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory

_SAMPLES = 24
_SHARES = np.array([0.0, 0.25, 0.5, 0.75])
_ON_PATH = 1e-8
_ALIGNED = 1e-6
_STEPS = 50
_PIECES = 16
_MOVING = 1e-9
_PARALLEL = 1e-6
# pieces ahead among which the end of a deceleration is looked for, so that a long path costs no more than a tick has
_MOST_EDGES = 4000


def is_straight(trajectory: Trajectory, begin: float = 0.0, end: float = math.inf) -> bool:
    """Return whether a trajectory changes the direction only at rest, between two times [s]."""
    end = min(end, trajectory.duration)
    inner = trajectory.edges[(trajectory.edges > begin) & (trajectory.edges < end)]
    bounds = np.concatenate([[begin], inner, [end]])
    return not any(_bends(trajectory, bounds[k : k + _PIECES + 1]) for k in range(0, len(bounds) - 1, _PIECES))


def _bends(trajectory: Trajectory, bounds: NDArray[np.float64]) -> bool:
    """Return whether the direction changes in some pieces; ``bounds`` are the ends."""
    within = (bounds[:-1, None] + np.diff(bounds)[:, None] * _SHARES).ravel()
    v = trajectory.span(np.append(within, bounds[-1])).v
    size = np.linalg.norm(v, axis=1)
    moving = size > _MOVING
    way = v / np.maximum(size, _MOVING)[:, None]
    before, after = way[:-1], way[1:]
    across = np.abs(after - (before * after).sum(axis=1)[:, None] * before).max(axis=1)
    return bool((across > _PARALLEL)[moving[:-1] & moving[1:]].any())


def brake_straight(
    trajectory: Trajectory, sigma: float, now: Setpoint, limits: MotionLimits
) -> tuple[PiecewisePolynomial, float] | None:
    """Return the deceleration from ``now`` and the end on the trajectory; None for a path not straight.

    Args:
        trajectory: What is followed.
        sigma: Place on it now.
        now: State there, as it moves, shape (n,).
        limits: Of the group.
    """
    k = int(np.argmax(np.abs(now.v)))
    if now.v[k] == 0.0:
        return None
    way = now.v / now.v[k]
    if (np.abs(now.a - way * now.a[k]) > _ALIGNED * limits.acceleration).any():
        return None
    stop = _along(way, k, now, limits)
    goal = float(stop.end_setpoint.q[k])
    end = _reached(trajectory, sigma, k, goal, bool(now.v[k] > 0.0), stop.duration)
    if end is None:
        return None
    stretch = trajectory.span(np.linspace(sigma, end, _SAMPLES)).q
    off = stretch - now.q - (stretch[:, k] - now.q[k])[:, None] * way
    if np.abs(off).max() > _ON_PATH or np.abs(trajectory.at(end).q - stop.end_setpoint.q).max() > _ON_PATH:
        return None
    return stop, end


def _along(way: NDArray[np.float64], k: int, now: Setpoint, limits: MotionLimits) -> PiecewisePolynomial:
    """Time-optimal deceleration in one direction, ``way``, shape (n,), which is 1 in joint ``k``."""
    _, acceleration, jerk = limits.along(way)
    change = min(max(float(now.a[k]), -acceleration), acceleration)
    profile = ramp((0.0, float(now.v[k]), change), 0.0, acceleration, jerk)
    coefficients = profile.coefficients * way
    coefficients[:, 0] += now.q
    return PiecewisePolynomial(profile.lengths.tolist(), coefficients)


def _reached(trajectory: Trajectory, sigma: float, k: int, goal: float, rising: bool, seconds: float) -> float | None:
    """Return the place at which joint ``k`` reaches ``goal`` on a straight way."""
    sign = 1.0 if rising else -1.0
    ahead = min(sigma + 3.0 * seconds, trajectory.duration)
    if sign * (float(trajectory.at(ahead).q[k]) - goal) < -_ON_PATH:
        # a path that turns round in between does not count
        ahead = trajectory.duration
    # where it rests on the way, as at a point of the path, it may come to the goal and turn back
    edges = trajectory.edges[(trajectory.edges > sigma) & (trajectory.edges < ahead)]
    if len(edges) > _MOST_EDGES:
        edges, ahead = edges[:_MOST_EDGES], float(edges[_MOST_EDGES])
    grid = np.union1d(np.linspace(sigma, ahead, 2 * _SAMPLES), edges)
    beyond = np.flatnonzero(sign * (trajectory.span(grid).q[:, k] - goal) >= -_ON_PATH * 1e-2)
    if not beyond.size or beyond[0] == 0:
        return None
    low, high = float(grid[beyond[0] - 1]), float(grid[beyond[0]])
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        if sign * (float(trajectory.at(middle).q[k]) - goal) < 0.0:
            low = middle
        else:
            high = middle
    return high
