"""Trajectory of polynomials, one after the other: the form of every kind of motion."""

import bisect
from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.trajectories.trajectory import Setpoint

_DEGREE = 5
_POWERS = np.arange(_DEGREE + 1)
# rows: value, first and second derivative; coefficients and exponents of the powers of time
_FACTORS = np.array([np.ones(6), _POWERS, _POWERS * (_POWERS - 1)])
_EXPONENTS = np.array([_POWERS, np.maximum(_POWERS - 1, 0), np.maximum(_POWERS - 2, 0)])


def powers(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows from coefficients to value, velocity and acceleration; ``t`` of shape (m,), answer (m, 3, 6)."""
    return np.asarray(_FACTORS * t[:, None, None] ** _EXPONENTS)


def powers_to_jerk(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same, and the third derivative; answer (m, 4, 6)."""
    third = _POWERS * (_POWERS - 1) * (_POWERS - 2) * t[:, None] ** np.maximum(_POWERS - 3, 0)
    return np.concatenate([powers(t), third[:, None]], axis=1)


class PiecewisePolynomial:
    """Polynomials of degree up to five in local time, shape (m, 6, n); stands still before and after.

    Attributes:
        edges: Times at which the pieces begin, shape (m,) [s].

    Args:
        lengths: Duration of each piece, shape (m,) [s].
        coefficients: Ascending powers of the time since the piece began, shape (m, 6, n).
        points: Index of the point of the path that each piece leads to, m of them; all 0 if not given.
    """

    def __init__(
        self,
        lengths: Sequence[float] | NDArray[np.float64],
        coefficients: NDArray[np.float64],
        points: Sequence[int] | None = None,
    ) -> None:
        self.lengths = np.asarray(lengths, dtype=np.float64)
        ends = np.cumsum(self.lengths)
        self.duration = float(ends[-1])
        self.edges = np.append(0.0, ends[:-1])
        self._starts: list[float] = self.edges.tolist()
        self.coefficients = coefficients
        self.points = list(points) if points is not None else [0] * len(coefficients)
        q = powers(self.lengths[-1:])[0] @ coefficients[-1]
        self._end = Setpoint.at_rest(q[0])

    @classmethod
    def standing(cls, q: NDArray[np.float64]) -> Self:
        """Standing still at ``q``, shape (n,)."""
        coefficients = np.zeros((1, 6, len(q)))
        coefficients[0, 0] = q
        return cls([0.0], coefficients)

    @classmethod
    def through(
        cls,
        times: NDArray[np.float64],
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        a: NDArray[np.float64],
        points: Sequence[int] | None = None,
    ) -> Self:
        """Return quintics through given positions, velocities and accelerations; continuous to acceleration.

        Args:
            times: Strictly increasing, from 0, shape (m + 1,) [s].
            q: Positions, shape (m + 1, n).
            v: Velocities, shape (m + 1, n).
            a: Accelerations, shape (m + 1, n).
            points: As in the constructor, m of them.
        """
        h = np.diff(times)
        return cls(h.tolist(), quintic(h, q, v, a), points)

    @property
    def end_setpoint(self) -> Setpoint:
        """Setpoint at the end, at rest."""
        return self._end

    def at(self, t: float) -> Setpoint:
        """Setpoint at time ``t`` [s]; at rest beyond the duration."""
        if t >= self.duration:
            return self._end
        i = max(bisect.bisect_right(self._starts, t) - 1, 0)
        x = t - self._starts[i]
        x2, x3 = x * x, x * x * x
        rows = np.array(
            (
                (1.0, x, x2, x3, x2 * x2, x2 * x3),
                (0.0, 1.0, 2.0 * x, 3.0 * x2, 4.0 * x3, 5.0 * x2 * x2),
                (0.0, 0.0, 2.0, 6.0 * x, 12.0 * x2, 20.0 * x3),
            )
        )
        q, v, a = rows.dot(self.coefficients[i])
        return Setpoint(q, v, a)

    def span(self, t: NDArray[np.float64]) -> Setpoint:
        """Return setpoints at times ``t``, shape (m,): q, v and a of shape (m, n)."""
        i = np.clip(np.searchsorted(self.edges, t, side="right") - 1, 0, None)
        x = np.minimum(t, self.duration) - self.edges[i]
        values = np.einsum("mrk,mkn->rmn", powers(x), self.coefficients[i])
        values[1:, t >= self.duration] = 0.0
        return Setpoint(values[0], values[1], values[2])

    def jerk(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Third derivative at times ``t``, shape (m,): shape (m, n); 0 beyond the duration."""
        i = np.clip(np.searchsorted(self.edges, t, side="right") - 1, 0, None)
        x = (t - self.edges[i])[:, None]
        c3, c4, c5 = self.coefficients[i, 3:].swapaxes(0, 1)
        jerk = 6.0 * c3 + x * (24.0 * c4 + 60.0 * x * c5)
        jerk[t >= self.duration] = 0.0
        return np.asarray(jerk)

    def point(self, t: float) -> int:
        """Return the index of the next point of the path."""
        return self.points[min(max(bisect.bisect_right(self._starts, t) - 1, 0), len(self.points) - 1)]

    def slower(self, factor: float) -> "PiecewisePolynomial":
        """The same path in ``factor`` times the time."""
        scale = (1.0 / factor) ** _POWERS
        return PiecewisePolynomial((self.lengths * factor).tolist(), self.coefficients * scale[:, None], self.points)

    def followed_by(self, others: Sequence["PiecewisePolynomial"]) -> "PiecewisePolynomial":
        """Return the trajectory followed by ``others``, each beginning at the end of the previous one."""
        parts = [self, *others]
        return PiecewisePolynomial(
            np.concatenate([part.lengths for part in parts]).tolist(),
            np.concatenate([part.coefficients for part in parts]),
            [point for part in parts for point in part.points],
        )


def quintic(
    h: NDArray[np.float64], q: NDArray[np.float64], v: NDArray[np.float64], a: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Coefficients, shape (m, 6, n), of the quintics through m + 1 positions, velocities and accelerations.

    Args:
        h: Times between them, shape (m,) [s].
        q: Positions, shape (m + 1, n).
        v: Velocities, shape (m + 1, n).
        a: Accelerations, shape (m + 1, n).
    """
    t = h[:, None]
    step = (q[1:] - q[:-1]) / t**3
    v0, v1, a0, a1 = v[:-1] / t**2, v[1:] / t**2, a[:-1] / t, a[1:] / t
    return np.stack(
        [
            q[:-1],
            v[:-1],
            a[:-1] / 2.0,
            10.0 * step - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
            (-15.0 * step + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1) / t,
            (6.0 * step - 3.0 * (v0 + v1) - 0.5 * (a0 - a1)) / t**2,
        ],
        axis=1,
    )


def cubic(h: NDArray[np.float64], q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients, shape (m, 6, n), of the cubics through m + 1 positions and velocities; arguments as above."""
    t = h[:, None]
    step = (q[1:] - q[:-1]) / t
    zero = np.zeros_like(step)
    second = (3.0 * step - 2.0 * v[:-1] - v[1:]) / t
    third = (v[:-1] + v[1:] - 2.0 * step) / t**2
    return np.stack([q[:-1], v[:-1], second, third, zero, zero], axis=1)
