"""Result of a search: markings, the step to each, and the firings between the markings."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from im_pnt.model.compiled import Compiled
from im_pnt_analysis.search.packing import Packing, TooManyTokensError, Units, Words

Numbers = npt.NDArray[np.int32]
"""Numbers of markings in the order in which they were found."""

_ALWAYS_MERGED = 1 << 15
_RATIO = 4


class Visited:
    """Keys in a few sorted runs, each several times as long as the next, so an addition moves few others."""

    def __init__(self) -> None:
        self._runs: list[tuple[Words, Numbers]] = []

    def find(self, keys: Words) -> Numbers:
        """Return the numbers of sorted keys, -1 for unknown ones."""
        result = np.full(len(keys), -1, np.int32)
        for known, numbers in self._runs:
            at = known.searchsorted(keys)
            at[at == len(known)] = 0
            hit = np.flatnonzero(known[at] == keys)
            result[hit] = numbers[at[hit]]
        return result

    def add(self, keys: Words, numbers: Numbers) -> None:
        """Add sorted new keys."""
        while self._runs:
            known, _ = self._runs[-1]
            if len(known) > _ALWAYS_MERGED and len(known) > _RATIO * len(keys):
                break
            keys, numbers = _merged(*self._runs.pop(), keys, numbers)
        self._runs.append((keys, numbers))


def _merged(known: Words, numbers: Numbers, keys: Words, fresh: Numbers) -> tuple[Words, Numbers]:
    total = len(known) + len(keys)
    places = known.searchsorted(keys) + np.arange(len(keys))
    old = np.ones(total, bool)
    old[places] = False
    all_keys, all_numbers = np.empty(total, np.uint64), np.empty(total, np.int32)
    all_keys[places], all_numbers[places] = keys, fresh
    all_keys[old], all_numbers[old] = known, numbers
    return all_keys, all_numbers


_Number = TypeVar("_Number", np.uint64, np.int32)
_FIRST_ROOM = 1 << 10
_REHASHES = 8
_SOON = 3
"""Width that every field of unproved bound gets as soon as one is too narrow: the others will be, too [bits]."""


class CollisionError(Exception):
    """Error: two markings have the same key; hash the markings anew."""


class StateSpace:
    """Markings in the order of the discovery, by the distance from the initial one.

    Args:
        compiled: The net.
        initial: Tokens of each place in the first marking.
        bounds: For each place the proved bound on its tokens, None where there is none.

    Attributes:
        packing: How they are packed.
        count: Number of markings.
        words: The markings, shape (words, room); those from ``count`` on mean nothing.
        keys: What they are looked up by, shape (room,).
        parents: The marking from which each was first reached, shape (room,); -1 for the first.
        rows: The step by which it was, shape (room,); -1 for the first.
        kinds: What kinds of transitions each expanded marking enables, as bits, shape (room,).
        visited: Finds the number of a key.
        fired: Which transitions are enabled somewhere, shape (transitions,).
        labelled_arcs: Number of pairs of an expanded marking and a transition it enables.
        distinct_edges: Number of pairs of an expanded marking and one reached by one firing.
    """

    def __init__(
        self,
        compiled: Compiled,
        initial: Sequence[int],
        bounds: Sequence[int | None],
    ) -> None:
        self.compiled, self.units = compiled, Units(compiled, initial)
        self._bounds = self.units.bounds(bounds)
        self._widths = self.units.widths(initial)
        self._attempt = 0
        self.packing = Packing(self.units, self._bounds, self._widths)
        self.count = 0
        self.words: Words = np.empty((self.packing.words, _FIRST_ROOM), np.uint64)
        self.keys: Words = self.words[0] if self.packing.words == 1 else np.empty(_FIRST_ROOM, np.uint64)
        self.parents: Numbers = np.empty(_FIRST_ROOM, np.int32)
        self.rows: Numbers = np.empty(_FIRST_ROOM, np.int32)
        self.kinds = np.zeros(_FIRST_ROOM, np.uint8)
        self.visited = Visited()
        self.fired = np.zeros(len(compiled.transitions), bool)
        self.labelled_arcs = self.distinct_edges = 0
        self._degrees: list[Numbers] = []
        self._targets: list[Numbers] = []
        self._arcs = 0
        first = self.packing.to_words([self.packing.pack(initial)])
        nobody = np.array([-1], np.int32)
        self.append(first, self.packing.keys(first), nobody, nobody)

    @property
    def memory(self) -> int:
        """Memory of the space, with the need of later questions about the arcs [bytes]."""
        return self.count * (16 * self.packing.words + 40) + 24 * self._arcs

    def reserve(self, count: int) -> None:
        """Make room for a number of markings."""
        if count <= len(self.parents):
            return
        room = max(count, len(self.parents) + (len(self.parents) >> 1))
        self.words = _longer(self.words, room, self.count)
        self.keys = self.words[0] if self.packing.words == 1 else _longer(self.keys, room, self.count)
        self.parents = _longer(self.parents, room, self.count)
        self.rows = _longer(self.rows, room, self.count)
        kinds = np.zeros(room, np.uint8)
        kinds[: len(self.kinds)] = self.kinds
        self.kinds = kinds

    def append(self, words: Words, keys: Words, parents: Numbers, rows: Numbers) -> None:
        """Add new markings.

        Raises:
            CollisionError: Two of them have the same key; they were added all the same.
        """
        begin, end = self.count, self.count + len(keys)
        self.reserve(end)
        self.words[:, begin:end] = words
        self.keys[begin:end] = keys
        self.parents[begin:end] = parents
        self.rows[begin:end] = rows
        self.count = end
        numbers = np.arange(begin, end, dtype=np.int32)
        if (keys[1:] <= keys[:-1]).any():
            order = np.argsort(keys)
            keys, numbers = keys[order], numbers[order]
            if (keys[1:] == keys[:-1]).any():
                raise CollisionError
        if len(keys):
            self.visited.add(np.array(keys), numbers)

    def add_arcs(self, degrees: Numbers, targets: Numbers) -> None:
        """Add the steps of the next markings: the numbers, and the targets."""
        self._degrees.append(degrees)
        self._targets.append(targets)
        self._arcs += len(targets)

    def arcs(self) -> tuple[npt.NDArray[np.int64], Numbers]:
        """Return the steps in rows: the beginning of each expanded marking, and the markings reached; without loops."""
        degrees = np.concatenate(self._degrees) if self._degrees else np.zeros(0, np.int32)
        targets = np.concatenate(self._targets) if self._targets else np.zeros(0, np.int32)
        self._degrees, self._targets = [degrees], [targets]
        begins = np.zeros(len(degrees) + 1, np.int64)
        np.cumsum(degrees, out=begins[1:])
        return begins, targets

    def widen(self, overflown: Sequence[int]) -> None:
        """Give fields more bits.

        Args:
            overflown: For each word the guard bits that were hit.
        """
        for place, field in enumerate(self.packing.fields):
            if overflown[field.word] >> (field.shift + field.width) & 1 and field.guarded:
                self._widths[place] = field.width + max(2, field.width // 2)
        self._widths = [max(width, _SOON) for width in self._widths]
        self._rebuild()

    def rehash(self) -> None:
        """Give the markings other keys."""
        self._attempt += 1
        self._rebuild()

    def _rebuild(self) -> None:
        older = self.packing
        while True:
            if self._attempt > _REHASHES:
                raise TooManyTokensError("the markings cannot be told apart by hashing")
            self.packing = Packing(self.units, self._bounds, self._widths, self._attempt)
            words = self.packing.repack(self.words[:, : self.count], older)
            keys = self.packing.keys(words)
            order = np.argsort(keys)
            sorted_keys = keys[order]
            if not (sorted_keys[1:] == sorted_keys[:-1]).any():
                break
            self._attempt += 1
        room = len(self.parents)
        self.words = _longer(words, room, self.count)
        self.keys = self.words[0] if self.packing.words == 1 else _longer(keys, room, self.count)
        self.visited = Visited()
        self.visited.add(sorted_keys, order.astype(np.int32))

    # One marking.

    def vector(self, number: int) -> tuple[int, ...]:
        """Return the tokens of each place of a marking."""
        return self.packing.unpack(self.packing.to_integers(self.words[:, number : number + 1])[0])

    def marking(self, number: int) -> dict[str, int]:
        """Return the marked places of a marking."""
        return self.compiled.marking(self.vector(number))

    def sequence(self, number: int, since: int = 0) -> tuple[str, ...]:
        """Return the firings to a marking from an earlier one on the path; a shortest from the first."""
        names = []
        while number != since and number > 0:
            parent = int(self.parents[number])
            vector = self.vector(parent)
            fired = (t for t in self.packing.members[self.rows[number]] if self.compiled.enabled(vector, t))
            names.append(self.compiled.transitions[next(fired)])
            number = parent
        return tuple(reversed(names))


def _longer(array: npt.NDArray[_Number], room: int, used: int) -> npt.NDArray[_Number]:
    result = np.empty((*array.shape[:-1], room), array.dtype)
    result[..., :used] = array[..., :used]
    return result
