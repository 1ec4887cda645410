"""P- and T-semiflows: weightings that no firing changes, and firing counts that change no marking.

Farkas' algorithm with elimination of non-minimal supports (Colom and Silva, 1991), bounded in its effort.
"""

from dataclasses import dataclass
from math import gcd

from im_pnt.compiled import Compiled


@dataclass(frozen=True, slots=True)
class Semiflows:
    """Minimal semiflows.

    Attributes:
        flows: Each a weighting of names with non-negative whole numbers, zeros left out.
        complete: Whether these are all of minimal support; False where the effort was capped.
    """

    flows: tuple[dict[str, int], ...]
    complete: bool

    def covers(self, names: tuple[str, ...]) -> bool:
        """Whether every name has a positive weight in some semiflow."""
        covered = {name for flow in self.flows for name in flow}
        return covered.issuperset(names)


def p_semiflows(compiled: Compiled, max_rows: int = 2_000) -> Semiflows:
    """Returns the minimal weightings of places that every firing leaves unchanged.

    Args:
        compiled: The net.
        max_rows: Rows of the working table at which to stop.
    """
    rows = [dict[int, int]() for _ in compiled.places]
    for transition, pairs in enumerate(compiled.change):
        for place, change in pairs:
            rows[place][transition] = change
    return _farkas(rows, compiled.places, len(compiled.transitions), max_rows)


def t_semiflows(compiled: Compiled, max_rows: int = 2_000) -> Semiflows:
    """Returns the minimal firing counts that lead from a marking back to it.

    Args:
        compiled: The net.
        max_rows: Rows of the working table at which to stop.
    """
    rows = [dict(pairs) for pairs in compiled.change]
    return _farkas(rows, compiled.transitions, len(compiled.places), max_rows)


Row = tuple[dict[int, int], dict[int, int]]
"""What is left of the incidence row, and the weighting that made it."""


def _farkas(start: list[dict[int, int]], names: tuple[str, ...], columns: int, max_rows: int) -> Semiflows:
    table: list[Row] = [(dict(row), {number: 1}) for number, row in enumerate(start)]
    left = set(range(columns))
    complete = True
    while left:
        column = min(left, key=lambda c: (_products(table, c), c))
        left.remove(column)
        positive = [row for row in table if row[0].get(column, 0) > 0]
        negative = [row for row in table if row[0].get(column, 0) < 0]
        table = [row for row in table if not row[0].get(column, 0)]
        if len(table) + len(positive) * len(negative) > max_rows:
            complete = False
            continue
        table.extend(_combine(up, down, column) for up in positive for down in negative)
        table = _minimal(table)
    flows = tuple({names[i]: weight for i, weight in sorted(weights.items())} for _, weights in table)
    return Semiflows(flows, complete)


def _products(table: list[Row], column: int) -> int:
    up = sum(1 for row, _ in table if row.get(column, 0) > 0)
    down = sum(1 for row, _ in table if row.get(column, 0) < 0)
    return up * down - up - down


def _combine(up: Row, down: Row, column: int) -> Row:
    a, b = up[0][column], -down[0][column]
    factor = gcd(a, b)
    rest = _weighted(up[0], b // factor, down[0], a // factor)
    weights = _weighted(up[1], b // factor, down[1], a // factor)
    common = gcd(*rest.values(), *weights.values())
    if common > 1:
        rest = {key: value // common for key, value in rest.items()}
        weights = {key: value // common for key, value in weights.items()}
    return rest, weights


def _weighted(a: dict[int, int], p: int, b: dict[int, int], q: int) -> dict[int, int]:
    total = {key: p * value for key, value in a.items()}
    for key, value in b.items():
        total[key] = total.get(key, 0) + q * value
    return {key: value for key, value in total.items() if value}


def _minimal(table: list[Row]) -> list[Row]:
    kept: list[tuple[frozenset[int], Row]] = []
    for row in sorted(table, key=lambda r: len(r[1])):
        support = frozenset(row[1])
        if not any(other <= support for other, _ in kept):
            kept.append((support, row))
    return [row for _, row in kept]
