"""Unbounded places, recognised in a search.

On an infinite search tree some path meets a marking that covers an earlier one of the same path (Karp and Miller,
1969); the firings between the two can be repeated for ever, provided that places which inhibit one of them are equal.
"""

from dataclasses import dataclass

import numpy as np

from im_core.clock import thread_cpu
from im_pnt_analysis.search.packing import Packing, Words
from im_pnt_analysis.search.state_space import StateSpace

_CHUNK = 1 << 15


@dataclass(frozen=True, slots=True)
class Growth:
    """Two markings of one path, numbers of the search; the later one covers the earlier one."""

    earlier: int
    later: int


class GrowthTest:
    """Comparison of each marking with all earlier ones on the path.

    Args:
        found: What a search finds; more of it each time :meth:`look` is called.
    """

    def __init__(self, found: StateSpace) -> None:
        self._found = found
        self._seen = 1

    def look(self, deadline: float) -> Growth | None:
        """Return the first growth among the markings found since the last call.

        Args:
            deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; the rest is looked at in the
                next call.
        """
        while self._seen < self._found.count:
            if thread_cpu() > deadline:
                return None
            end = min(self._found.count, self._seen + _CHUNK)
            growth = self._compare(self._seen, end, deadline)
            if growth is not None or thread_cpu() > deadline:
                return growth
            self._seen = end
        return None

    def _compare(self, begin: int, end: int, deadline: float) -> Growth | None:
        found, packing = self._found, self._found.packing
        later = np.arange(begin, end, dtype=np.int32)
        current = later
        fixed = _inhibiting(packing)
        equal = np.zeros((packing.words, len(later)), np.uint64)
        best: Growth | None = None
        while len(current) and thread_cpu() <= deadline:
            equal |= fixed[:, found.rows[current]]
            current = found.parents[current]
            covers = _covers(packing, found.words[:, later], found.words[:, current], equal)
            if covers.any():
                first = int(np.flatnonzero(covers)[0])
                best = Growth(int(current[first]), int(later[first]))
            going = (current > 0) & (later < (best.later if best else end))
            later, current, equal = later[going], current[going], equal[:, going]
        return best


def _covers(packing: Packing, later: Words, earlier: Words, equal: Words) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    result = np.ones(later.shape[1], bool)
    plain = _unguarded(packing)
    for word in range(packing.words):
        guards, bits = packing.guards[word], plain[word]
        result &= ((later[word] ^ earlier[word]) & (equal[word] | bits)) == 0
        result &= (((later[word] & ~bits) | guards) - (earlier[word] & ~bits)) & guards == guards
    return result


def _unguarded(packing: Packing) -> Words:
    """Return the bits of places proved to hold one token at most: such places cannot grow."""
    bits = [0] * packing.words
    for field in packing.fields:
        if not field.guarded:
            bits[field.word] |= 1 << field.shift
    return np.array(bits, np.uint64)


def _inhibiting(packing: Packing) -> Words:
    """Return the bits of the inhibiting places of each row, shape (words, rows)."""
    bits = [[0] * len(packing.members) for _ in range(packing.words)]
    for row, members in enumerate(packing.members):
        for transition in members:
            for place, _ in packing.units.inhibitors[transition]:
                field = packing.fields[place]
                bits[field.word][row] |= ((1 << field.width) - 1) << field.shift
    return np.array(bits, np.uint64).reshape(packing.words, -1)
