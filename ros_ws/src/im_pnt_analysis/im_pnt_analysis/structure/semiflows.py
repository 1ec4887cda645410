"""P- and T-semiflows: weightings unchanged by any firing, and firing counts without an effect on the marking.

Farkas' algorithm with elimination of non-minimal supports (Colom and Silva, 1991), bounded in its effort. Where it was
capped, linear programming finds semiflows for what the others leave out.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from math import gcd

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, IndexedArcs

_EFFORT = 20
"""Combinations tried for a column, as a multiple of the rows allowed."""


@dataclass(frozen=True, slots=True)
class Semiflows:
    """Minimal semiflows.

    Attributes:
        flows: Each a weighting of names with non-negative whole numbers, zeros left out; a true semiflow in any case.
        complete: Whether these are all of minimal support; False where the effort was capped.
        reason: Why not, empty if they are.
    """

    flows: tuple[dict[str, int], ...]
    complete: bool
    reason: str = ""

    def covers(self, names: Iterable[str]) -> bool:
        """Whether every name has a positive weight in some semiflow."""
        covered = {name for flow in self.flows for name in flow}
        return covered.issuperset(names)

    def place_bounds(self, places: Sequence[str], initial: Sequence[int]) -> list[int | None]:
        """Return the bound on the tokens of each place by P-semiflows; None: none."""
        number = {name: index for index, name in enumerate(places)}
        bounds: list[int | None] = [None] * len(number)
        for flow in self.flows:
            total = sum(weight * initial[number[name]] for name, weight in flow.items())
            for name, weight in flow.items():
                bound = bounds[number[name]]
                bounds[number[name]] = total // weight if bound is None else min(bound, total // weight)
        return bounds


def p_semiflows(compiled: Compiled, max_rows: int = 2_000, deadline: float | None = None) -> Semiflows:
    """Return the minimal weightings of places unchanged by every firing.

    Args:
        compiled: The net.
        max_rows: Rows of the working table at which to leave some out.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to stop [s]; None: never.
    """
    return _semiflows(_by_place(compiled), compiled.places, compiled.change, max_rows, deadline)


def t_semiflows(compiled: Compiled, max_rows: int = 2_000, deadline: float | None = None) -> Semiflows:
    """Return the minimal firing counts from a marking back to the same marking.

    Args:
        compiled: The net.
        max_rows: Rows of the working table at which to leave some out.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to stop [s]; None: never.
    """
    return _semiflows(compiled.change, compiled.transitions, _by_place(compiled), max_rows, deadline)


def _by_place(compiled: Compiled) -> list[IndexedArcs]:
    rows: list[list[tuple[int, int]]] = [[] for _ in compiled.places]
    for transition, pairs in enumerate(compiled.change):
        for place, change in pairs:
            rows[place].append((transition, change))
    return [tuple(row) for row in rows]


def _semiflows(
    rows: Sequence[IndexedArcs],
    names: tuple[str, ...],
    columns: Sequence[IndexedArcs],
    max_rows: int,
    deadline: float | None,
) -> Semiflows:
    table = _Table(rows, max_rows, deadline)
    table.eliminate(set(range(len(columns))))
    flows = [row.weights for row in table.rows.values() if not row.rest]
    if table.reason:
        flows.extend(_missing(flows, len(names), columns, deadline))
    named = tuple({names[i]: weight for i, weight in sorted(weights.items())} for weights in flows)
    return Semiflows(named, not table.reason, table.reason)


def _missing(
    flows: list[dict[int, int]], size: int, columns: Sequence[IndexedArcs], deadline: float | None
) -> Iterator[dict[int, int]]:
    """Yield semiflows for uncovered components, where there are any."""
    from im_pnt_analysis.structure.state_equation import Cone

    cone = Cone(columns, size)
    covered = {index for weights in flows for index in weights}
    for index in range(size):
        if index not in covered and (deadline is None or thread_cpu() < deadline):
            weights = cone.cheapest([1] * size, [index], equal=True, deadline=deadline)
            if weights:
                covered.update(weights)
                common = gcd(*weights.values())
                yield {key: weight // common for key, weight in weights.items()}


@dataclass(slots=True)
class _Row:
    """Rest of the incidence row, the weighting, and the support as a set of bits."""

    rest: dict[int, int]
    weights: dict[int, int]
    support: int


class _Table:
    """The working table of Farkas' algorithm."""

    def __init__(self, start: Sequence[IndexedArcs], max_rows: int, deadline: float | None) -> None:
        self.rows: dict[int, _Row] = {}
        self.reason = ""
        self._max_rows = max(max_rows, len(start))
        self._deadline = deadline
        self._next = 0
        self._positive: dict[int, set[int]] = {}
        self._negative: dict[int, set[int]] = {}
        self._changed: set[int] = set()
        for index, pairs in enumerate(start):
            self._add(_Row(dict(pairs), {index: 1}, 1 << index))

    def eliminate(self, columns: set[int]) -> None:
        """Make the rest of every row zero, as far as time and room permit."""
        cheapest = [(self._growth(column), column) for column in columns]
        heapify(cheapest)
        while columns:
            growth, column = heappop(cheapest)
            if column not in columns or growth != self._growth(column):
                continue  # its growth has changed, and is in the heap, too
            columns.remove(column)
            self._changed.clear()
            up, down = sorted(self._positive.get(column, ())), sorted(self._negative.get(column, ()))
            parents = [self.rows[number] for number in up], [self.rows[number] for number in down]
            for number in up + down:
                self._remove(number)
            if not self._combine(column, *parents):
                return
            for changed in self._changed:
                heappush(cheapest, (self._growth(changed), changed))

    def _growth(self, column: int) -> int:
        up, down = len(self._positive.get(column, ())), len(self._negative.get(column, ()))
        return up * down - up - down

    def _combine(self, column: int, up: list[_Row], down: list[_Row]) -> bool:
        """Add the combinations without a column and with minimal support. Return whether there is time left."""
        tried = 0
        for first in sorted(up, key=lambda row: len(row.weights)):
            for second in sorted(down, key=lambda row: len(row.weights)):
                tried += 1
                if tried % 64 == 1 and self._deadline is not None and thread_cpu() > self._deadline:
                    self.reason = "the time is up"
                    return False
                if len(self.rows) >= self._max_rows or tried > _EFFORT * self._max_rows:
                    self.reason = f"more than {self._max_rows} rows of the working table"
                    return True
                support = first.support | second.support
                if any(row.support & support == row.support for row in self.rows.values()):
                    continue
                for number in [n for n, row in self.rows.items() if row.support & support == support]:
                    self._remove(number)
                self._add(_combination(first, second, column))
        return True

    def _add(self, row: _Row) -> None:
        self.rows[self._next] = row
        for column, value in row.rest.items():
            (self._positive if value > 0 else self._negative).setdefault(column, set()).add(self._next)
        self._changed.update(row.rest)
        self._next += 1

    def _remove(self, number: int) -> None:
        rest = self.rows.pop(number).rest
        for column, value in rest.items():
            (self._positive if value > 0 else self._negative)[column].discard(number)
        self._changed.update(rest)


def _combination(up: _Row, down: _Row, column: int) -> _Row:
    a, b = up.rest[column], -down.rest[column]
    factor = gcd(a, b)
    rest = _weighted(up.rest, b // factor, down.rest, a // factor)
    weights = _weighted(up.weights, b // factor, down.weights, a // factor)
    common = gcd(*rest.values(), *weights.values())
    if common > 1:
        rest = {key: value // common for key, value in rest.items()}
        weights = {key: value // common for key, value in weights.items()}
    return _Row(rest, weights, up.support | down.support)


def _weighted(a: dict[int, int], p: int, b: dict[int, int], q: int) -> dict[int, int]:
    total = {key: p * value for key, value in a.items()}
    for key, value in b.items():
        total[key] = total.get(key, 0) + q * value
    return {key: value for key, value in total.items() if value}
