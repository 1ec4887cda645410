"""The state equation in inequalities: semiflows and weightings, found by linear programming, checked exactly.

Semiflows and weightings that no firing raises are non-negative whole-number vectors of a cone. A linear program finds
them in floating point; one counts only after it has been rounded to whole numbers and put to every inequality. A
weighting y >= 0 of the places that no firing raises (y C <= 0) bounds a place p by y m0 / y_p (Murata, 1989): no firing
sequence at all can exceed that.
"""

from collections.abc import Collection, Sequence
from fractions import Fraction
from math import lcm

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, IndexedArcs

_LARGEST = 10**9
"""Coefficients beyond this are not given to floating point."""
_DENOMINATORS = (1, 60, 5_000, 1_000_000)


class Cone:
    """The vectors x >= 0 with rows . x <= 0.

    Args:
        rows: Each the pairs of index and coefficient of an inequality.
        size: Length of the vectors.
    """

    def __init__(self, rows: Sequence[IndexedArcs], size: int) -> None:
        self._rows = rows
        self._size = size
        entries = [(number, index, value) for number, row in enumerate(rows) for index, value in row]
        self._numeric = bool(size and entries) and all(abs(value) <= _LARGEST for _, _, value in entries)
        if self._numeric:
            numbers, indices, values = zip(*entries, strict=True)
            self._matrix = csr_array((np.array(values, float), (numbers, indices)), shape=(len(rows), size))

    def cheapest(
        self,
        costs: Sequence[int],
        positive: Collection[int] = (),
        *,
        equal: bool = False,
        deadline: float | None = None,
    ) -> dict[int, int]:
        """Return a vector of the cone of about the least cost, zeros left out; empty: none was found.

        Args:
            costs: Cost of each component.
            positive: Components that are positive.
            equal: Whether every inequality is met with equality.
            deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; None: never.
        """
        if not self._numeric:
            return self._exactly({index: Fraction(1) for index in positive}, positive, equal=equal)
        left = None if deadline is None else max(0.01, deadline - thread_cpu())
        lower = np.zeros(self._size)
        lower[list(positive)] = 1.0
        zeros = np.zeros(len(self._rows))
        inequalities, right = (None, None) if equal else (self._matrix, zeros)
        solution = linprog(
            [float(min(cost, 10**12)) for cost in costs],  # beyond, small costs would be lost in rounding
            A_ub=inequalities,
            b_ub=right,
            A_eq=self._matrix if equal else None,
            b_eq=zeros if equal else None,
            bounds=np.column_stack([lower, np.full(self._size, np.inf)]),
            method="highs",
            options={} if left is None else {"time_limit": left},
        )
        if solution.x is None or not np.isfinite(solution.x).all():
            return {}
        for denominator in _DENOMINATORS:  # floats prove nothing: the simplest fractions near them are checked exactly
            rounded = {
                int(index): Fraction(float(solution.x[index])).limit_denominator(denominator)
                for index in np.flatnonzero(solution.x > 1e-9)
            }
            if vector := self._exactly(rounded, positive, equal=equal):
                return vector
        return {}

    def _exactly(self, vector: dict[int, Fraction], positive: Collection[int], *, equal: bool) -> dict[int, int]:
        """Return a vector in whole numbers if contained in the cone, otherwise nothing."""
        common = lcm(*(value.denominator for value in vector.values()))
        whole = {index: int(value * common) for index, value in vector.items() if value > 0}
        sums = [sum(whole.get(index, 0) * value for index, value in row) for row in self._rows]
        fits = all(number == 0 if equal else number <= 0 for number in sums)
        return whole if fits and whole.keys() >= set(positive) else {}


def weightings(compiled: Compiled) -> Cone:
    """Return the cone of the weightings of places not raised by any firing."""
    return Cone(compiled.change, len(compiled.places))


def structurally_bounded(compiled: Compiled, deadline: float | None = None) -> bool:
    """Return whether every place is bounded for any initial marking; a place may be bounded all the same.

    Args:
        compiled: The net; inhibitor arcs are left out, which keeps the answer true.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; None: never.
    """
    places = range(len(compiled.places))
    return not places or bool(weightings(compiled).cheapest([1] * len(places), places, deadline=deadline))
