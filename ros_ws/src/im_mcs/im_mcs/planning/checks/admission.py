"""Admission of a request to a group: as many values as joints, all within the limits."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, LimitError
from im_mcs.limits.motion_limits import BeyondLimits
from im_mcs.planning.checks.context import PlanContext
from im_mcs.protocol.points import TimedPoints
from im_mcs.protocol.requests import LARGEST, JointMove, LineMove, Move, StreamRequest, TrajectoryMove

POINTS_AT_ONCE = 2000
"""Points of a trajectory that are looked at when it is asked for; the others are when it is prepared."""
_ROUNDING = 1e-6


def check_move(context: PlanContext, move: Move) -> None:
    """Check a path against the joints of a group.

    Raises:
        DataError: A wrong size, a value that is not finite, or a motion of two wrists for one.
        LimitError: A position, velocity or acceleration is beyond its limit; names joint, value, limit and unit.
    """
    if isinstance(move, JointMove):
        _check_points(context, move.points)
    elif isinstance(move, LineMove):
        _check_pair(context, move)
    elif isinstance(move, TrajectoryMove):
        check_timed_points(context, move.points, 0)


def check_timed_points(context: PlanContext, points: TimedPoints, begin: int) -> None:
    """Check some points of a trajectory, from one on; as many as may be looked at in one tick.

    Raises:
        DataError: A wrong size, a value that is not finite.
        LimitError: A position, velocity or acceleration is beyond its limit; names joint, value, limit and unit.
    """
    some, motion = slice(begin, begin + POINTS_AT_ONCE), context.limits.motion.of(context.index)
    _check_points(context, points.q[some], begin)
    # what may be re-timed may be beyond limits, but not beyond numbers
    any_finite = np.full(len(context.index), np.finfo(np.float64).max / 2.0)
    retimed = context.config.planning.beyond_limits is BeyondLimits.RETIME
    for values, limit, words in (
        (points.v, motion.velocity, ("velocities", "velocity", "/s")),
        (points.a, motion.acceleration, ("accelerations", "acceleration", "/s2")),
    ):
        if values is not None:
            _check_derivative(context, values[some], any_finite if retimed else limit, words, begin)


def check_stream(context: PlanContext, request: StreamRequest) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return position and velocity of a streaming setpoint, shape (n,) each, the velocity strictly within the limit.

    Raises:
        DataError: A wrong size, or a value that is not finite.
        LimitError: A position is out of range, a velocity too large, or the joint could not stop before its limit.
    """
    limits, index = context.limits, context.index
    q = limits.check_positions(index, request.positions, "the setpoint")
    v = per_joint(context, request.velocities, "velocities")
    if v is None:
        return q, np.zeros_like(q)
    motion = limits.motion.of(index)
    _check_within(context, v, motion.velocity, "velocity of the setpoint", "/s")
    v = np.clip(v, -motion.velocity, motion.velocity)  # ruckig tolerates no rounding
    speed = np.abs(v)
    way = speed * (speed / motion.acceleration + motion.acceleration / motion.jerk) / 2.0
    stop = q + np.sign(v) * way
    beyond = (stop < limits.lower[index]) | (stop > limits.upper[index])
    if beyond.any():
        k = int(np.argmax(beyond))
        i = index[k]
        limit = float(limits.lower[i] if v[k] < 0.0 else limits.upper[i])
        raise LimitError(
            joint=limits.names[i],
            value=float(stop[k]),
            limit=limit,
            unit=limits.units[i],
            what=f"position at which it could stop from the setpoint's velocity {v[k]:.6g} {limits.units[i]}/s",
        )
    return q, v


def check_jog(context: PlanContext, request: StreamRequest) -> NDArray[np.float64]:
    """Return the wanted velocity of the joints, shape (n,), or of the wrist, shape (6,).

    Raises:
        DataError: A wrong size, a value that is not finite or too large, or a twist without a frame.
    """
    if request.kind == "twist":
        if len(request.velocities) != 6:
            raise DataError(f"the twist has {len(request.velocities)} values, not 6: linear and angular velocity")
        if not all(map(math.isfinite, request.velocities)):
            raise DataError(f"the twist {request.velocities} has a value that is not a finite number")
        if not request.frame:
            raise DataError("the twist names no frame; world, the wrist, or any other frame of the cell may be named")
        velocity = np.array(request.velocities, dtype=np.float64)
    else:
        velocity = context.limits.check_finite(context.index, request.velocities, "jog", "velocity")
    if np.abs(velocity).max() > LARGEST:
        raise DataError(f"the {request.kind} has a velocity beyond {LARGEST:g}")
    return velocity


def per_joint(context: PlanContext, values: Sequence[float], what: str) -> NDArray[np.float64] | None:
    """Finite values, shape (n,), or None for none.

    Raises:
        DataError: Not as many as joints, or one is not finite.
    """
    if not len(values):
        return None
    names = [context.limits.names[i] for i in context.index]
    if len(values) != len(names):
        raise DataError(f"{what}: {len(values)} values for {len(names)} joints ({', '.join(names)})")
    for name, value in zip(names, values, strict=True):
        if not math.isfinite(value):
            raise DataError(f"{what}: {name}: {value} is not a finite number", joint=name)
    return np.array(values, dtype=np.float64)


def _check_pair(context: PlanContext, move: LineMove) -> None:
    """Check a line of two wrists."""
    if (move.relative is not None or move.points is not None) and len(context.frames) < 2:
        has = f"one wrist, {context.frames[0]}" if context.frames else "no wrist"
        raise DataError(f"the group has {has}; relative poses, and points of a first wrist, are for a group of two")
    for number, point in enumerate(() if move.points is None else move.points.tolist(), start=1):
        context.limits.check_positions(context.lead, point, f"point {number}")


def _check_points(context: PlanContext, q: NDArray[np.float64], begin: int = 0) -> None:
    """Check positions of points, shape (m, n), of which the first is the one of rank ``begin``."""
    limits, index = context.limits, context.index
    if q.shape[1] == len(index):
        inside = (q >= limits.lower[index]) & (q <= limits.upper[index])
        if inside.all():
            return
        number = int(np.argmin(inside.all(axis=1)))
    else:
        number = 0
    limits.check_positions(index, q[number].tolist(), f"point {begin + number + 1}")


def _check_derivative(
    context: PlanContext,
    values: NDArray[np.float64],
    limit: NDArray[np.float64],
    words: tuple[str, str, str],
    begin: int,
) -> None:
    """Check velocities or accelerations of points, shape (m, n), the first of rank ``begin``, named by ``words``."""
    what, one, unit = words
    if values.shape[1] == len(limit):
        inside = np.abs(values) <= limit * (1.0 + _ROUNDING)
        if inside.all():
            return
        number = int(np.argmin(inside.all(axis=1)))
    else:
        number = 0
    point = f"point {begin + number + 1}"
    per_joint(context, values[number].tolist(), f"{point}: {what}")
    _check_within(context, values[number], limit, f"{one} of {point}", unit)


def _check_within(
    context: PlanContext, values: NDArray[np.float64], limit: NDArray[np.float64], what: str, unit: str
) -> None:
    """Check values, shape (n,), against limits, shape (n,); ``unit`` follows the unit of the position."""
    beyond = np.abs(values) > limit * (1.0 + _ROUNDING)
    if beyond.any():
        k = int(np.argmax(beyond))
        i = context.index[k]
        unit = context.limits.units[i] + unit
        raise LimitError(
            joint=context.limits.names[i], value=float(values[k]), limit=float(limit[k]), unit=unit, what=what
        )
