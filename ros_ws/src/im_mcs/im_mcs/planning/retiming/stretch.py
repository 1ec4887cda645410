"""One stretch of a requested trajectory, from rest to rest, re-timed within every joint's limits."""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.planning.checks.envelope import excess
from im_mcs.planning.retiming.asked_path import CHUNK, AskedPath
from im_mcs.planning.retiming.law import TimeLaw, gentle
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, quintic

Array = NDArray[np.float64]

# share of the limits that is aimed at: the rest is for what lies between nodes
_SHARE = 0.985
_ENOUGH = 1.01
_ROUNDS, _PATIENCE, _STUCK = 14, 4, 0.95
# what a whole stretch may be slowed down by, and how deep rests may be nested that spare it that
_SLOWEST, _STOPS = 1.3, 5
# a stretch that becomes longer than this is given a rest instead
_LONGEST_S, _LONGER = 10.0, 10.0
# share of the acceleration that a change of the rate may take
_CHANGE = 0.35
_SHORTEST_SPAN_S = 0.03
_APART = 1.0 / 3.0
_SPANS = 5
_MORE = 1.08
_TINY = 1e-300
MOST_PIECES = 250_000
"""Of a re-timed motion: a quarter of an hour and more, and a hundred megabytes."""


def check_count(pieces: float, asked_s: float) -> None:
    """Check whether a motion is short enough for preparation and memory.

    Args:
        pieces: Of the motion.
        asked_s: Time asked for [s].

    Raises:
        DataError: It has too many pieces.
    """
    if not pieces <= MOST_PIECES:
        raise DataError(
            f"a stretch of {asked_s:.4g} s is beyond limits, and its re-timing needs {pieces:.7g} pieces; "
            f"at most {MOST_PIECES} are allowed",
            value=pieces,
            limit=MOST_PIECES,
        )


@dataclass(frozen=True)
class Retimed:
    """Stretch in the new time.

    Attributes:
        lengths: Of its pieces, shape (m,) [s].
        coefficients: Shape (m, 6, n).
        asked: Asked times at the ends of its pieces, shape (m + 1,) [s].
    """

    lengths: Array
    coefficients: Array
    asked: Array


def retime_stretch(
    trajectory: PiecewisePolynomial, begin: float, end: float, limits: MotionLimits, stops: int = _STOPS
) -> Generator[None, None, list[Retimed]]:
    """Re-time the part between two rests, a slice at a time; return parts and rests.

    Where limits are passed, the rate is lowered, there and as far around as the average reaches. Where that does not
    help, as where a path turns too sharply for its cells, the motion rests; what is left slows down the whole stretch.

    Args:
        trajectory: Asked.
        begin: Asked time of the first rest [s].
        end: Of the second.
        limits: Of its joints.
        stops: How many rests it may be given, one within the other.

    Raises:
        DataError: It takes too long, or is so quick that floating-point numbers end.
    """
    path = AskedPath(trajectory, begin, end, limits.velocity)
    yield from path.measure()
    speed = np.append(path.speed[0], path.speed[1, -1])
    speed[[0, -1]] = 0.0
    square, room = _first_rates(path, limits)  # squared: accelerations are linear in them
    square = gentle(square, room)
    before, longest = np.inf, _LONGEST_S + _LONGER * (end - begin)
    for rank in range(_ROUNDS):
        law = yield from _law(path, speed * np.sqrt(square), limits)
        nodes, retimed, over = yield from _motion(path, law, limits)
        if not np.isfinite(over).all():
            when = float(retimed.asked[int(np.argmin(np.isfinite(over)))])
            raise DataError(
                f"the trajectory is too fast to be re-timed on the way to point {trajectory.point(when) + 1}, "
                f"at {when:.9g} s; give it more time",
                time=when,
            )
        worst = float(over.max())
        if worst <= _ENOUGH or (rank >= _PATIENCE and worst > _STUCK * before) or law.duration > longest:
            break
        before = worst
        slower = np.minimum(1.0 / over, 1.0)
        square = gentle(square * _around(law, slower, float(nodes[1])) ** 2, room)
    place = float(retimed.asked[int(over.argmax()) : int(over.argmax()) + 2].mean())  # rest where it is worst
    if worst > _SLOWEST and stops > 0 and begin < place < end:
        before_it = yield from retime_stretch(trajectory, begin, place, limits, stops - 1)
        behind_it = yield from retime_stretch(trajectory, place, end, limits, stops - 1)
        return before_it + behind_it
    factor = max(1.0, worst, (end - begin) / law.duration)  # never faster than asked
    scale = (1.0 / factor) ** np.arange(6)[:, None]
    for k in range(0, len(over), 10 * CHUNK):
        retimed.coefficients[k : k + 10 * CHUNK] *= scale
        yield
    return [Retimed(retimed.lengths * factor, retimed.coefficients, retimed.asked)]


def _around(law: TimeLaw, slower: Array, step: float) -> Array:
    """The least of some factors where the speed at the ends of cells matters, shape (m + 1,).

    Args:
        law: Law in force.
        slower: Factors of pieces of time of one length, one after the other.
        step: Length of these [s].
    """
    reach = int(np.ceil((law.duration - law.times[-1]) / step)) + 1
    later = least_ahead(slower, reach)
    at = np.clip((law.times / step).astype(np.intp), 0, len(slower) - 1)
    within = np.minimum(np.minimum.reduceat(slower, at)[:-1], np.minimum(later[at[:-1]], later[at[1:]]))
    return np.asarray(np.minimum(np.append(within, 1.0), np.append(1.0, within)))


def least_ahead(values: Array, reach: int) -> Array:
    """Return the least of each value and `reach` later ones, as far as there are any, shape (m,)."""
    least, width = values.copy(), 1
    while width <= reach:
        step = min(width, reach + 1 - width)
        least[:-step] = np.minimum(least[:-step], least[step:])
        width += step
    return least


def _first_rates(path: AskedPath, limits: MotionLimits) -> tuple[Array, Array]:
    """Return squares of rates at cell ends within velocity and across-acceleration limits, and room for changes."""
    fast = np.maximum(np.abs(path.first), np.abs(path.last))
    cells = np.minimum(1.0, (_SHARE * limits.velocity / np.maximum(fast, _TINY)).min(axis=1)) ** 2
    for side, v in ((0, path.first), (1, path.last)):
        moves, across = path.speed[side] > 0.0, np.zeros_like(v)
        along = path.slope[side][moves] / np.maximum(path.speed[side][moves], _TINY)
        across[moves] = np.abs(path.turn[side][moves] - v[moves] * along[:, None])
        cells = np.minimum(cells, (_SHARE * limits.acceleration / np.maximum(across, _TINY)).min(axis=1))
    square = np.minimum(np.append(cells, 1.0), np.append(1.0, cells))
    room = 2.0 * _CHANGE * (limits.acceleration / np.maximum(fast, _TINY)).min(axis=1) * np.diff(path.tau)
    return square, np.minimum(room, 1.0)


def _law(path: AskedPath, speed: Array, limits: MotionLimits) -> Generator[None, None, TimeLaw]:
    """Return the law with the shortest average to turn the jumps of acceleration along the path into ramps.

    Raises:
        DataError: It takes too long.
    """
    used = (np.abs(path.first) + np.abs(path.last)) / limits.jerk
    jerk = (path.speed[0] + path.speed[1]) / np.maximum(used.max(axis=1), _TINY)
    longest = 2.0 * float((limits.acceleration / limits.jerk).max())
    span = _SHORTEST_SPAN_S
    for _ in range(_SPANS):
        law = TimeLaw(path.way, speed, span, span * _APART)
        check_count(law.pieces, float(path.tau[-1] - path.tau[0]))
        nodes, needed = law.nodes(), 0.0
        for k in range(0, len(nodes) - 1, 4 * CHUNK):
            t = nodes[k : k + 4 * CHUNK + 1]
            way, _, change = law.at(t)
            at = np.clip(np.searchsorted(path.way, way[1:]) - 1, 0, len(jerk) - 1)
            needed = max(needed, float((np.abs(np.diff(change)) / np.diff(t) / jerk[at]).max()) * span)
            yield
        if needed * _MORE <= span or span == longest:
            break
        span = min(max(needed * _MORE, span * _MORE), longest)
    return law


def _motion(path: AskedPath, law: TimeLaw, limits: MotionLimits) -> Generator[None, None, tuple[Array, Retimed, Array]]:
    """Return quintics through the motion at nodes, and the excess of each over limits, as a factor of the time."""
    nodes = law.nodes()
    h, count = np.diff(nodes), len(nodes) - 1
    states, asked = np.empty((count + 1, 3, len(limits.jerk))), np.empty(count + 1)
    coefficients, over = np.empty((count, 6, len(limits.jerk))), np.empty(count)
    for k in range(0, count, CHUNK):
        first, last = k + (k > 0), min(k + CHUNK, count)
        states[first : last + 1], asked[first : last + 1] = path.motion(*law.at(nodes[first : last + 1]))
        yield
        if k == 0:
            states[0], asked[0] = path.rest(0)
        if last == count:
            states[-1], asked[-1] = path.rest(-1)
        part = slice(k, last)
        q, v, a = states[k : last + 1].swapaxes(0, 1)
        coefficients[part] = quintic(h[part], q, v, a)
        over[part] = excess(coefficients[part], h[part], limits) / _SHARE
        yield
    return nodes, Retimed(h, coefficients, asked), over
