"""Requested path between two rests over a separate coordinate, with path and time apart.

The coordinate ``l`` is the way in joint space, every joint in units of its velocity limit. Over the asked time it grows
with the asked speed ``s(tau)``, kept in cells as quintics with the speed's value, slope and bend at both ends; so the
jump of an acceleration that points along the path is a matter of time alone: over ``l`` the path is smooth there. With
``tau' = l' / s`` and ``tau'' = (l'' - s' tau'^2) / s``:

    v = q' tau',   a = q'' tau'^2 + q' tau''
"""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, powers, powers_to_jerk

Array = NDArray[np.float64]

# length of a cell in the time asked for; the same of one that would be passed at full speed, if the time is too short
_CELL_S, _CELL_AT_FULL_SPEED_S = 0.01, 0.02
# of a piece, whose bends are as long as itself, and of a whole path
_MOST_CELLS, _MOST_IN_ALL = 1000, 200_000
# cells of a piece next to a rest, where the speed begins with 0
_CELLS_AT_REST = 10
_NEWTON = 6
_STILL = 1e-9
# where a stretch ends it rests, if the path turns there within such a time: its curvature is of no size
_STILL_S = 1e-6
_TINY = 1e-100
CHUNK = 400
"""Places that are evaluated in one slice."""


class AskedPath:
    """A stretch of an asked trajectory, from rest to rest.

    Attributes:
        tau: Asked times of the ends of its cells, shape (m + 1,) [s].
        piece: Piece of the trajectory that each cell is in, shape (m,).
        speed: Asked speed at both ends of each cell, shape (2, m).
        slope: Its slope there, shape (2, m).
        turn: Acceleration of every joint there, shape (2, m, n).
        way: Coordinate at the ends of the cells, shape (m + 1,).
        first, last: Velocity of every joint at the begin and the end of each cell, shape (m, n).

    Args:
        asked: The trajectory.
        begin: Asked time at which the stretch begins [s].
        end: At which it ends.
        unit: Velocity of each joint that counts as 1, shape (n,).

    Raises:
        DataError: It is too long.
    """

    def __init__(self, asked: PiecewisePolynomial, begin: float, end: float, unit: Array) -> None:
        self._asked, self._unit = asked, unit
        edges = asked.edges
        i = int(np.searchsorted(edges, begin, side="right")) - 1
        j = int(np.searchsorted(edges, end, side="left"))
        inner = edges[i + 1 : j]
        bounds = np.concatenate([[begin], inner, [end]])
        lengths = np.diff(bounds)
        ways = np.abs(asked.coefficients[i : i + len(lengths), 1:] / unit)
        far = (ways * lengths[:, None, None] ** np.arange(1, 6)[:, None]).sum(axis=1).max(axis=1)
        fine = np.minimum(np.maximum(lengths / _CELL_S, far / _CELL_AT_FULL_SPEED_S), _MOST_CELLS)
        counts = np.maximum(np.ceil(fine - 1e-6), 1.0).astype(np.intp)
        counts[[0, -1]] = np.maximum(counts[[0, -1]], _CELLS_AT_REST)
        if (many := int(counts.sum())) > _MOST_IN_ALL:
            raise DataError(
                f"a stretch of {end - begin:.4g} s is beyond limits, and its re-timing needs {many} cells; "
                f"at most {_MOST_IN_ALL} are allowed",
                value=many,
                limit=_MOST_IN_ALL,
            )
        rank = np.repeat(np.arange(len(lengths)), counts)
        within = np.arange(len(rank)) - np.repeat(np.cumsum(counts) - counts, counts)
        self.piece = rank + i
        self._size = (lengths / counts)[rank]
        self.tau = np.append(bounds[rank] + within * self._size, end)
        self._x = np.maximum(self.tau[:-1] - edges[self.piece], 0.0)
        m, n = len(rank), len(unit)
        self.speed, self.slope, self._bend = np.empty((2, m)), np.empty((2, m)), np.empty((2, m))
        self.first, self.last, self.turn = np.empty((m, n)), np.empty((m, n)), np.empty((2, m, n))
        self.way = np.zeros(m + 1)

    def measure(self) -> Generator[None, None, None]:
        """Find speeds and the coordinate, a slice at a time."""
        m = len(self.piece)
        for k in range(0, m, CHUNK):
            part = slice(k, min(k + CHUNK, m))
            for side, offset, v in ((0, 0.0, self.first), (1, self._size[part], self.last)):
                self._look(side, part, self._x[part] + offset, v)
            yield
        self._series = np.empty((6, m))
        for k in range(0, m, 10 * CHUNK):
            some = slice(k, k + 10 * CHUNK)
            size = self._size[some]
            series = _hermite(self.speed[:, some], self.slope[:, some] * size, self._bend[:, some] * size**2)
            self._series[:, some] = series
            self.way[1:][some] = np.maximum((series / np.arange(1, 7)[:, None]).sum(axis=0), 0.0) * size
            yield
        np.cumsum(self.way, out=self.way)

    def _look(self, side: int, part: slice, x: Array, v: Array) -> None:
        """Speed, slope and bend at one end of some cells."""
        values = powers_to_jerk(x) @ self._asked.coefficients[self.piece[part]]
        v[part], self.turn[side, part] = values[:, 1], values[:, 2]
        way, turn, twist = (values / self._unit)[:, 1:].swapaxes(0, 1)
        speed = np.sqrt((way**2).sum(axis=1))
        slope = (way * turn).sum(axis=1) / np.maximum(speed, _TINY)
        bend = ((turn**2).sum(axis=1) + (way * twist).sum(axis=1) - slope**2) / np.maximum(speed, _TINY)
        # at rest the speed is that of |a| x + a j / |a| x^2 / 2, x seconds away from it
        force = np.sqrt((turn**2).sum(axis=1))
        still = speed <= _STILL
        if side == 0 and part.start == 0:
            still[0] |= speed[0] <= _STILL_S * force[0]
        if side == 1 and part.stop == len(self.piece):
            still[-1] |= speed[-1] <= _STILL_S * force[-1]
        if still.any():
            some = force > _STILL
            sign = -1.0 if side else 1.0
            slope[still] = sign * np.where(some, force, 0.0)[still]
            pull = (turn * twist).sum(axis=1) / np.maximum(force, _TINY)
            jolt = np.sqrt((twist**2).sum(axis=1))
            bend[still] = np.where(some, sign * pull, jolt)[still]
            speed[still] = 0.0
        self.speed[side, part], self.slope[side, part], self._bend[side, part] = speed, slope, bend

    def states(self, piece: NDArray[np.intp], x: Array) -> Array:
        """Position and the derivatives over the asked time, shape (m, 3, n), at times ``x`` within pieces."""
        return np.asarray(powers(x) @ self._asked.coefficients[piece])

    def rest(self, cell: int) -> tuple[Array, float]:
        """Return state, shape (3, n), and requested time at one of the ends: of the first cell (0) or the last (-1)."""
        x = self._x[cell] + (self._size[-1] if cell else 0.0)
        states = np.zeros((3, len(self._unit)))
        states[0] = self.states(self.piece[[cell]], np.array([x]))[0, 0]
        return states, float(self.tau[cell])

    def motion(self, way: Array, rate: Array, change: Array) -> tuple[Array, Array]:
        """Positions, velocities, accelerations, shape (m, 3, n), and asked times, shape (m,).

        Args:
            way: Coordinates, shape (m,).
            rate: Their first derivative over time.
            change: Their second.
        """
        cell = np.clip(np.searchsorted(self.way, way, side="right") - 1, 0, len(self.piece) - 1)
        h = self._size[cell]
        c0, c1, c2, c3, c4, c5 = self._series[:, cell]
        s1 = self.speed[1, cell]
        left = np.maximum(way - self.way[cell], 0.0) / h
        u = 2.0 * left / np.maximum(c0 + np.sqrt(np.maximum(c0**2 + 2.0 * (s1 - c0) * left, 0.0)), _TINY)
        u = np.clip(u, 0.0, 1.0)
        for _ in range(_NEWTON):
            covered = u * (c0 + u * (c1 / 2 + u * (c2 / 3 + u * (c3 / 4 + u * (c4 / 5 + u * c5 / 6)))))
            speed = c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
            u = np.clip(u - (covered - left) / np.maximum(speed, _TINY), 0.0, 1.0)
        speed = np.maximum(c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5)))), _TINY)
        slope = (c1 + u * (2 * c2 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / h
        values = self.states(self.piece[cell], self._x[cell] + u * h)
        quick = rate / speed
        along = (change - slope * quick**2) / speed
        values[:, 2] = values[:, 2] * (quick**2)[:, None] + values[:, 1] * along[:, None]
        values[:, 1] *= quick[:, None]
        return values, self.tau[cell] + u * h


def _hermite(value: Array, slope: Array, bend: Array) -> Array:
    """Coefficients, shape (6, m), of the quintics over 0 to 1 with given values and derivatives, shape (2, m) each."""
    step = value[1] - value[0]
    return np.stack(
        [
            value[0],
            slope[0],
            bend[0] / 2.0,
            10.0 * step - 6.0 * slope[0] - 4.0 * slope[1] - 1.5 * bend[0] + 0.5 * bend[1],
            -15.0 * step + 8.0 * slope[0] + 7.0 * slope[1] + 1.5 * bend[0] - bend[1],
            6.0 * step - 3.0 * (slope[0] + slope[1]) - 0.5 * (bend[0] - bend[1]),
        ]
    )
