"""Markings packed into 64-bit words, and transitions on packed markings: one subtraction compares every input at once.

Tokens are counted in the steps in which firings change them, so that large weights need no large numbers. Each place
has a field of bits for them. Above the value of most fields lies a guard bit, zero in every stored marking; a guard bit
that is set after a firing says that the field has become too narrow. A place that is proved to hold one unit at most
needs no guard.

With the guard bits set, ``marking - weights`` leaves the guard of a place set exactly where it holds enough tokens, and
nothing is borrowed from the next field. A place without a guard holds one unit at most: its bit is the answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd

import numpy as np
import numpy.typing as npt

from im_pnt.model.compiled import Compiled, IndexedArcs


class Units:
    """A net in units: a place holds ``rest + step * units`` tokens.

    Args:
        compiled: The net.
        initial: Tokens of each place in the first marking.

    Attributes:
        names: Names of the places.
        step: For each place the greatest common divisor of what firings change.
        rest: For each place the tokens that never leave it, fewer than a step.
        inputs: For each transition its input arcs in units, those left out that are always met.
        inhibitors: For each transition its inhibitor arcs in units; 0: it is always inhibited.
        change: For each transition its effect in units.
    """

    def __init__(self, compiled: Compiled, initial: Sequence[int]) -> None:
        self.names = compiled.places
        self.step = [0] * len(initial)
        for change in compiled.change:
            for place, delta in change:
                self.step[place] = gcd(self.step[place], delta)
        self.step = [step or max(1, count) for step, count in zip(self.step, initial, strict=True)]
        self.rest = [count % step for count, step in zip(initial, self.step, strict=True)]
        self.inputs = tuple(
            tuple((place, units) for place, units in self._needed(arcs) if units) for arcs in compiled.inputs
        )
        self.inhibitors = tuple(self._needed(arcs) for arcs in compiled.inhibitors)
        self.change = tuple(
            tuple((place, delta // self.step[place]) for place, delta in change) for change in compiled.change
        )

    def of(self, place: int, tokens: int) -> int:
        """Return the units of a place with a number of tokens."""
        return (tokens - self.rest[place]) // self.step[place]

    def tokens(self, place: int, units: int) -> int:
        """Return the tokens of a place with a number of units."""
        return self.rest[place] + self.step[place] * units

    def needed(self, place: int, tokens: int) -> int:
        """Return the least units of a place with at least a number of tokens."""
        return max(0, -((self.rest[place] - tokens) // self.step[place]))

    def _needed(self, arcs: IndexedArcs) -> IndexedArcs:
        return tuple((place, self.needed(place, weight)) for place, weight in arcs)

    def bounds(self, tokens: Sequence[int | None]) -> list[int | None]:
        """Return bounds on tokens as bounds on units."""
        return [None if bound is None else self.of(place, bound) for place, bound in enumerate(tokens)]

    def widths(self, initial: Sequence[int]) -> list[int]:
        """Return for each place the bits of the first units and of every arc weight."""
        largest = [max(1, self.of(place, count)) for place, count in enumerate(initial)]
        for arcs in (*self.inputs, *self.inhibitors, *self.change):
            for place, units in arcs:
                largest[place] = max(largest[place], abs(units))
        return [units.bit_length() for units in largest]


Words = npt.NDArray[np.uint64]
"""Packed markings, shape (words, markings), or numbers of that kind."""

WORD = 64
_KEY_SEED = 0x1D2C3B4A


class TooManyTokensError(Exception):
    """A place can hold more tokens than a word counts; the text says which."""


@dataclass(frozen=True, slots=True)
class BitField:
    """Where the tokens of a place are: word, shift and width in bits, and whether a guard bit lies above."""

    word: int
    shift: int
    width: int
    guarded: bool


@dataclass(frozen=True, slots=True)
class WordComparison:
    """Comparison of one word for some conditions: ``((word | guards) - amount) & mask`` tells."""

    word: int
    rows: npt.NDArray[np.intp] | slice
    amount: Words
    mask: Words


class Packing:
    """Layout of the fields of a marking, and the transitions of a net as constants in the layout.

    Transitions with the same effect share a row; a row is one possible step.

    Args:
        units: The net in units.
        bounds: For each place the proved bound on its units, None where there is none.
        widths: For each place without a proved bound the width of its field [bits].
        attempt: Number of the hash of the keys, where markings need more than a word.

    Raises:
        TooManyTokensError: A field would be wider than a word.

    Attributes:
        units: The net in units.
        fields: The field of each place.
        words: Words of a marking.
        guards: Guard bits of each word, shape (words,).
        hash: For each place the factor of its units in the key of a marking of several words.
        row_of: For each transition the row of its effect; -1: it changes nothing, -2: it can never fire.
        members: For each row its transitions.
        change: Effect of each row on each word, shape (words, rows).
        key_change: Effect of each row on the key, shape (rows,).
    """

    def __init__(self, units: Units, bounds: Sequence[int | None], widths: Sequence[int], attempt: int = 0) -> None:
        self.units = units
        self.fields = _lay_out(units, bounds, widths)
        self.words = 1 + max((field.word for field in self.fields), default=0)
        guards = [0] * self.words
        for field in self.fields:
            if field.guarded:
                guards[field.word] |= 1 << (field.shift + field.width)
        self.guards: Words = np.array(guards, np.uint64)
        self.hash = _hash(len(self.fields), attempt)
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
        """Number the enabling conditions; transitions with the same condition share the test."""
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
        """Return for each relevant word the amount to subtract, and the deciding bits."""
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

    def _collect(self, *, inputs: bool) -> list[WordComparison]:
        rows: dict[int, list[tuple[int, int, int]]] = {}
        for row, transition in enumerate(self._tested):
            for word, (amount, mask) in self._amounts(transition, inputs=inputs).items():
                rows.setdefault(word, []).append((row, amount, mask))
        tests = []
        for word, entries in sorted(rows.items()):
            numbers, amounts, masks = zip(*entries, strict=True)
            which = slice(None) if len(entries) == len(self._tested) else np.array(numbers, np.intp)
            tests.append(WordComparison(word, which, np.array(amounts, np.uint64), np.array(masks, np.uint64)))
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

    # Markings.

    def pack(self, vector: Sequence[int]) -> int:
        """Return a marking, in tokens, as one integer, word 0 in the lowest bits."""
        return sum(
            self.units.of(place, count) << (f.word * WORD + f.shift)
            for place, (count, f) in enumerate(zip(vector, self.fields, strict=True))
        )

    def unpack(self, packed: int) -> tuple[int, ...]:
        """Return the tokens of each place."""
        return tuple(
            self.units.tokens(place, (packed >> (f.word * WORD + f.shift)) & ((1 << f.width) - 1))
            for place, f in enumerate(self.fields)
        )

    def column(self, words: Words, place: int) -> Words:
        """Return the units of one place in many markings."""
        field = self.fields[place]
        units: Words = (words[field.word] >> np.uint64(field.shift)) & np.uint64((1 << field.width) - 1)
        return units

    def holds(self, words: Words, place: int, tokens: int) -> npt.NDArray[np.bool_]:
        """Return the markings in which a place holds at least a number of tokens."""
        needed = self.units.needed(place, tokens)
        if needed >> self.fields[place].width:
            return np.zeros(words.shape[1], bool)
        enough: npt.NDArray[np.bool_] = self.column(words, place) >= np.uint64(needed)
        return enough

    def repack(self, words: Words, older: "Packing") -> Words:
        """Return markings of an older layout in the layout of the packing."""
        result = np.zeros((self.words, words.shape[1]), np.uint64)
        for place, field in enumerate(self.fields):
            result[field.word] |= older.column(words, place) << np.uint64(field.shift)
        return result

    def keys(self, words: Words) -> Words:
        """Return the keys for the lookup of markings: the word as is, or a hash of several words."""
        if self.words == 1:
            only: Words = words[0]
            return only
        result = np.zeros(words.shape[1], np.uint64)
        for place, factor in enumerate(self.hash):
            result += self.column(words, place) * np.uint64(factor)
        return result

    def to_words(self, packed: Sequence[int]) -> Words:
        """Return integers as words."""
        if self.words == 1:
            return np.array(packed, np.uint64).reshape(1, -1)
        size = self.words * 8
        flat = np.frombuffer(b"".join([m.to_bytes(size, "little") for m in packed]), np.dtype("<u8"))
        return np.ascontiguousarray(flat.reshape(-1, self.words).T).astype(np.uint64, copy=False)

    def to_integers(self, words: Words) -> list[int]:
        """Return words as integers."""
        if self.words == 1:
            integers: list[int] = words[0].tolist()
            return integers
        data, size = np.ascontiguousarray(words.T).astype("<u8", copy=False).tobytes(), self.words * 8
        return [int.from_bytes(data[at : at + size], "little") for at in range(0, len(data), size)]

    # Transitions.

    def enabled(self, words: Words) -> npt.NDArray[np.bool_]:
        """Return the enabled transitions, shape (transitions, markings)."""
        result = np.empty((len(self._tested), words.shape[1]), bool)
        result[:] = self._conceivable[:, None]
        for test in self.tests:
            result[test.rows] &= self._left(words, test) == test.mask[:, None]
        for test in self.stops:
            result[test.rows] &= self._left(words, test) == 0
        return result if self._condition is None else result[self._condition]

    def _left(self, words: Words, test: WordComparison) -> Words:
        left: Words = (words[test.word] | self.guards[test.word])[None, :] - test.amount[:, None]
        left &= test.mask[:, None]
        return left

    def steps(self, enabled: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return the possible rows, shape (rows, markings)."""
        if len(self.members) == len(enabled):
            return enabled
        rows = enabled[[members[0] for members in self.members]]
        for row, members in enumerate(self.members):
            for other in members[1:]:
                rows[row] |= enabled[other]
        return rows


def _lay_out(units: Units, bounds: Sequence[int | None], widths: Sequence[int]) -> tuple[BitField, ...]:
    fields: list[BitField] = []
    word = used = 0
    for place, (bound, width) in enumerate(zip(bounds, widths, strict=True)):
        guarded = bound is None or bound > 1
        bits = max(1, bound.bit_length()) if bound is not None else width
        size = bits + guarded
        if size > WORD:
            raise TooManyTokensError(f"place {units.names[place]} may hold too many tokens to list the markings")
        if used + size > WORD:
            word, used = word + 1, 0
        fields.append(BitField(word, used, bits, guarded))
        used += size
    return tuple(fields)


def _hash(places: int, attempt: int) -> list[int]:
    """Return an odd factor for each place; the sum of the products is a hash, changed by a constant in a firing."""
    dice = np.random.Generator(np.random.PCG64(_KEY_SEED + attempt))
    return [2 * int(factor) + 1 for factor in dice.integers(0, 1 << 63, places, dtype=np.uint64)]
