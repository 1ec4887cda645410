"""Time of each place on the path: the requested speed, slowed down where needed, then smoothed over time.

A non-negative average over a span of time keeps the place on the path between the smallest and the largest of that
span: the path is kept, no speed and no acceleration along it grows, jumps of acceleration become ramps, rest stays
rest, and all of it costs the span once.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_NODES = (1.0 + _POINTS) / 2.0
_SHARES = _WEIGHTS / 2.0
_NODES_A_SPAN, _FEWEST = 8.0, 4
_NODE_S = (0.004, 0.01)
_TINY = 1e-300


class TimeLaw:
    """Places over time: speeds change evenly between the ends of cells, then are averaged.

    The average is that of a box of length ``span``, and of some of them a little apart, so that jerk has no jumps.

    Attributes:
        duration: From rest to rest [s].
        times: When the path without averages is at the ends of its cells, shape (m + 1,) [s].

    Args:
        way: Coordinate at the ends of cells, shape (m + 1,).
        speed: Speed there, slowed down, shape (m + 1,); 0 at both ends.
        span: Length of the box [s].
        apart: How far boxes are apart at most [s].
    """

    def __init__(self, way: Array, speed: Array, span: float, apart: float) -> None:
        self._way, self._speed = way, speed
        steps = np.diff(way)
        lengths = 2.0 * steps / np.maximum(speed[:-1] + speed[1:], _TINY)
        self._change = np.diff(speed) / np.maximum(lengths, _TINY)
        self.times = np.concatenate([[0.0], np.cumsum(lengths)])
        area = lengths * (way[:-1] + lengths * (speed[:-1] / 2.0 + lengths * self._change / 6.0))
        self._area = np.concatenate([[0.0], np.cumsum(area)])
        self._span, self._apart = span, apart
        self.duration = float(self.times[-1]) + span + apart

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return coordinate, the velocity and acceleration at times ``t``, shape (m,) each."""
        way, rate, change = np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
        for node, share in zip(_NODES, _SHARES, strict=True):
            late = t - node * self._apart
            after, before = self._raw(late), self._raw(late - self._span)
            for total, a, b in zip((way, rate, change), after, before, strict=False):
                total += (share / self._span) * (a - b)
        return np.minimum(way, self._way[-1]), np.maximum(rate, 0.0), change

    @property
    def pieces(self) -> float:
        """Number of quintics for the law; infinite for a law without progress."""
        step = min(max((self._span + self._apart) / _NODES_A_SPAN, _NODE_S[0]), _NODE_S[1])
        return max(float(np.ceil(self.duration / step)), _FEWEST)

    def nodes(self) -> Array:
        """Return times of nodes of the path with good quintics between the nodes, shape (m,) [s]."""
        return np.linspace(0.0, self.duration, int(self.pieces) + 1)

    def _raw(self, t: Array) -> tuple[Array, Array, Array]:
        """Return integral and value of the coordinate without averages, and the velocity, as base of the averages."""
        end = self.times[-1]
        cell = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self._change) - 1)
        x = np.clip(t, 0.0, end) - self.times[cell]
        s, c = self._speed[cell], self._change[cell]
        way = self._way[cell] + x * (s + x * c / 2.0)
        area = self._area[cell] + x * (self._way[cell] + x * (s / 2.0 + x * c / 6.0))
        beyond = np.maximum(t - end, 0.0)
        speed = np.where((t < 0.0) | (t > end), 0.0, s + x * c)
        return area + beyond * self._way[-1], way, speed


def gentle(square: Array, room: Array) -> Array:
    """Return largest squares of rates, not above the given ones, with neighbour changes of at most ``room``.

    Args:
        square: Shape (m,).
        room: Largest change between each and the next, shape (m - 1,).
    """
    place = np.concatenate([[0.0], np.cumsum(room)])
    ahead = np.minimum.accumulate(square - place) + place
    back = np.minimum.accumulate((square + place)[::-1])[::-1] - place
    return np.asarray(np.minimum(ahead, back))
