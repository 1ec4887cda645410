"""Transitions on packed markings, so that one subtraction compares every input of a transition at once.

With the guard bits set, ``marking - weights`` leaves the guard of a place set exactly where it holds enough tokens, and
nothing is borrowed from the next field. A place without a guard holds one unit at most: its bit is the answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from im_pnt.analysis.fields import WORD, Fields, Words
from im_pnt.analysis.units import Units


@dataclass(frozen=True, slots=True)
class Test:
    """Comparison of one word for some conditions: ``((word | guards) - amount) & mask`` tells."""

    word: int
    rows: npt.NDArray[np.intp] | slice
    amount: Words
    mask: Words


class Whole(NamedTuple):
    """A transition in whole-marking integers; enabled where every ``mask`` bit stays and no ``stop_mask`` bit does."""

    amount: int
    mask: int
    stop_amount: int
    stop_mask: int
    change: int
    row: int


class Packing(Fields):
    """The transitions of a net as constants in a layout of its markings.

    Transitions with the same effect share a row; a row is one possible step.

    Args:
        units: The net in units.
        bounds: For each place the proved bound on its units, None where there is none.
        widths: For each place without a proved bound the width of its field [bits].
        attempt: Number of the hash of the keys, where markings need more than a word.

    Attributes:
        row_of: For each transition the row of its effect; -1: it changes nothing, -2: it can never fire.
        members: For each row its transitions.
        change: Effect of each row on each word, shape (words, rows).
        key_change: Effect of each row on the key, shape (rows,).
    """

    def __init__(
        self, units: Units, bounds: Sequence[int | None], widths: Sequence[int], attempt: int = 0
    ) -> None:
        super().__init__(units, bounds, widths, attempt)
        self._bounds = bounds
        self.possible = np.array([self._possible(t) for t in range(len(units.inputs))], bool)
        self._number_rows()
        self._number_conditions()
        self.tests = self._collect(inputs=True)
        self.stops = self._collect(inputs=False)
        self._place_change()

    def _possible(self, transition: int) -> bool:
        bounds, units = self._bounds, self.units
        needs = (*units.inputs[transition], *units.change[transition])
        stopped = any(weight == 0 for _, weight in units.inhibitors[transition])
        return not stopped and all((bound := bounds[place]) is None or amount <= bound for place, amount in needs)

    def _number_rows(self) -> None:
        rows: dict[tuple[tuple[int, int], ...], int] = {}
        self.row_of: list[int] = []
        self.members: list[list[int]] = []
        for transition, change in enumerate(self.units.change):
            if not self.possible[transition]:
                self.row_of.append(-2)
            elif not change:
                self.row_of.append(-1)
            else:
                row = rows.setdefault(tuple(sorted(change)), len(rows))
                if row == len(self.members):
                    self.members.append([])
                self.members[row].append(transition)
                self.row_of.append(row)

    def _number_conditions(self) -> None:
        """Transitions that are enabled under the same condition share its test."""
        conditions: dict[object, int] = {}
        self._tested: list[int] = []
        numbers = []
        arcs = zip(self.units.inputs, self.units.inhibitors, strict=True)
        for transition, (inputs, inhibitors) in enumerate(arcs):
            key = (frozenset(inputs), frozenset(inhibitors), bool(self.possible[transition]))
            number = conditions.setdefault(key, len(conditions))
            if number == len(self._tested):
                self._tested.append(transition)
            numbers.append(number)
        shared = len(conditions) < len(numbers)
        self._condition = np.array(numbers, np.intp) if shared else None
        self._conceivable = self.possible[self._tested]

    def _amounts(self, transition: int, *, inputs: bool) -> dict[int, tuple[int, int]]:
        """Returns for each word that matters what to subtract, and the bits that tell."""
        found: dict[int, tuple[int, int]] = {}
        arcs = self.units.inputs[transition] if inputs else self.units.inhibitors[transition]
        for place, weight in arcs:
            field, bound = self.fields[place], self._bounds[place]
            if bound is not None and weight > bound:
                continue
            amount, mask = found.get(field.word, (0, 0))
            if field.guarded:
                amount |= weight << field.shift
            mask |= 1 << (field.shift + field.width if field.guarded else field.shift)
            found[field.word] = amount, mask
        return found

    def _collect(self, *, inputs: bool) -> list[Test]:
        rows: dict[int, list[tuple[int, int, int]]] = {}
        for row, transition in enumerate(self._tested):
            for word, (amount, mask) in self._amounts(transition, inputs=inputs).items():
                rows.setdefault(word, []).append((row, amount, mask))
        tests = []
        for word, entries in sorted(rows.items()):
            numbers, amounts, masks = zip(*entries, strict=True)
            which = slice(None) if len(entries) == len(self._tested) else np.array(numbers, np.intp)
            tests.append(Test(word, which, np.array(amounts, np.uint64), np.array(masks, np.uint64)))
        return tests

    def _place_change(self) -> None:
        n_rows = len(self.members)
        self.change: Words = np.zeros((self.words, n_rows), np.uint64)
        wrap = (1 << WORD) - 1
        keys = [0] * n_rows
        for row, members in enumerate(self.members):
            words: dict[int, int] = {}
            for place, delta in self.units.change[members[0]]:
                field = self.fields[place]
                words[field.word] = words.get(field.word, 0) + (delta << field.shift)
                keys[row] += self.hash[place] * delta
            for word, change in words.items():
                self.change[word, row] = change & wrap
        hashed: Words = np.array([x & wrap for x in keys], np.uint64)
        self.key_change = self.change[0] if self.words == 1 else hashed

    def enabled(self, words: Words) -> npt.NDArray[np.bool_]:
        """Returns which transitions are enabled, shape (transitions, markings)."""
        result = np.empty((len(self._tested), words.shape[1]), bool)
        result[:] = self._conceivable[:, None]
        for test in self.tests:
            result[test.rows] &= self._left(words, test) == test.mask[:, None]
        for test in self.stops:
            result[test.rows] &= self._left(words, test) == 0
        return result if self._condition is None else result[self._condition]

    def _left(self, words: Words, test: Test) -> Words:
        left: Words = (words[test.word] | self.guards[test.word])[None, :] - test.amount[:, None]
        left &= test.mask[:, None]
        return left

    def steps(self, enabled: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Returns which rows can be taken, shape (rows, markings)."""
        if len(self.members) == len(enabled):
            return enabled
        rows = enabled[[members[0] for members in self.members]]
        for row, members in enumerate(self.members):
            for other in members[1:]:
                rows[row] |= enabled[other]
        return rows

    def near_rows(self) -> list[frozenset[int]]:
        """Returns for each row the transitions that a step of it may enable or disable."""
        tests: list[set[int]] = [set() for _ in self.fields]
        for transition, arcs in enumerate(zip(self.units.inputs, self.units.inhibitors, strict=True)):
            if self.possible[transition]:
                for place, _ in (*arcs[0], *arcs[1]):
                    tests[place].add(transition)
        changes = (self.units.change[members[0]] for members in self.members)
        return [frozenset().union(*(tests[place] for place, _ in change)) for change in changes]

    def whole(self) -> list[tuple[int, Whole]]:
        """Returns the transitions that can fire, as constants for whole-marking integers."""
        result = []
        for transition, row in enumerate(self.row_of):
            if row == -2:
                continue
            needs, stops = (self._amounts(transition, inputs=inputs) for inputs in (True, False))
            change = sum(
                delta << (self.fields[place].word * WORD + self.fields[place].shift)
                for place, delta in self.units.change[transition]
            )
            result.append((transition, Whole(*_joined(needs), *_joined(stops), change, row)))
        return result


def _joined(amounts: dict[int, tuple[int, int]]) -> tuple[int, int]:
    amount = sum(value << (WORD * word) for word, (value, _) in amounts.items())
    return amount, sum(mask << (WORD * word) for word, (_, mask) in amounts.items())
