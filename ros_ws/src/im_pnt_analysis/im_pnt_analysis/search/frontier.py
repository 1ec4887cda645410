"""One step of breadth-first search: a wide frontier in arrays, a narrow one marking by marking.

Arrays cost the same for one marking as for a hundred; below that, plain integers are faster.
"""

from collections.abc import Collection, Sequence

import numpy as np

from im_pnt_analysis.search.packing import WORD
from im_pnt_analysis.search.state_space import CollisionError, StateSpace


class OverflowedError(Exception):
    """Error: a field has become too narrow; ``guards`` are the hit guard bits, for each word."""

    def __init__(self, guards: Sequence[int]) -> None:
        super().__init__("a field is too narrow")
        self.guards = guards


def expand_wide(found: StateSpace, begin: int, end: int, kinds: Sequence[int]) -> None:
    """Fire all enabled transitions of the markings of one layer.

    Args:
        found: What was found; all of it or nothing is added.
        begin: First marking.
        end: First marking that is not expanded.
        kinds: Bits that each transition contributes to a marking that enables it.

    Raises:
        OverflowedError: A field is too narrow.
        CollisionError: Two markings have the same key.
    """
    packing = found.packing
    enabled = packing.enabled(found.words[:, begin:end])
    steps = packing.steps(enabled)
    n_rows = len(steps)
    if n_rows:
        flat = np.flatnonzero(np.ascontiguousarray(steps.T))
        sources = flat // n_rows
        rows = flat - sources * n_rows
        sources += begin
    else:
        sources = rows = np.zeros(0, np.intp)
    after = found.keys[sources] + packing.key_change[rows]  # keys are linear: a firing adds a constant
    order = np.argsort(after)  # equal markings stand side by side, and get one number
    in_order = after[order]
    new_key = np.ones(len(after), bool)
    np.not_equal(in_order[1:], in_order[:-1], out=new_key[1:])
    firsts = np.flatnonzero(new_key)
    unique = in_order[firsts]
    numbers = found.visited.find(unique)
    fresh = np.flatnonzero(numbers < 0)
    numbers[fresh] = np.arange(found.count, found.count + len(fresh))
    targets = np.empty(len(after), np.int32)
    targets[order] = numbers[np.cumsum(new_key) - 1]
    chosen = order[firsts[fresh]]
    parents, by = sources[chosen], rows[chosen]
    words = found.words[:, parents] + packing.change[:, by]
    hit = np.bitwise_or.reduce(words, axis=1) & packing.guards  # a carry into a guard bit: too many tokens
    if hit.any():
        raise OverflowedError([int(bits) for bits in hit])
    if packing.words > 1:  # a key of one word is the marking; of more words a hash, which may collide
        found.reserve(found.count + len(fresh))
        found.words[:, found.count : found.count + len(fresh)] = words
        for word, change in zip(found.words, packing.change, strict=True):
            if not np.array_equal(word[targets], word[sources] + change[rows]):
                raise CollisionError
    found.append(words, unique[fresh], parents.astype(np.int32), by.astype(np.int32))
    degrees = np.bincount(sources - begin, minlength=end - begin).astype(np.int32)
    found.add_arcs(degrees, targets)
    found.fired |= enabled.any(axis=1)
    found.labelled_arcs += int(np.count_nonzero(enabled))
    found.distinct_edges += len(targets)
    loops = [t for t, row in enumerate(packing.row_of) if row == -1]  # they change nothing, but are edges
    if loops:
        found.distinct_edges += int(np.count_nonzero(enabled[loops].any(axis=0)))
    for kind in {bit for bits in kinds for bit in (1, 2) if bits & bit}:
        members = [t for t, bits in enumerate(kinds) if bits & kind]
        some = enabled.any(axis=0) if len(members) == len(enabled) else enabled[members].any(axis=0)
        found.kinds[begin:end] |= some.astype(np.uint8) * np.uint8(kind)


_FULL = (1 << WORD) - 1


class NarrowFrontier:
    """Expands narrow layers marking by marking.

    A marking is one integer. Only the transitions next to the places that a firing has changed are looked at again.

    Args:
        found: What was found; what is met here enters it at :meth:`flush`.
        begin: First marking to expand.
        kinds: Bits that each transition contributes to a marking that enables it.
    """

    def __init__(self, found: StateSpace, begin: int, kinds: Sequence[int]) -> None:
        self._found, self._begin = found, begin
        packing = found.packing
        self._guards = sum(int(bits) << (WORD * word) for word, bits in enumerate(packing.guards))
        self._program = dict(packing.whole())
        self._kinds_of = kinds
        self._near = packing.near_rows()
        self._shared = len(packing.members) < sum(row >= 0 for row in packing.row_of)
        waiting = slice(begin, found.count)
        self._markings = packing.to_integers(found.words[:, waiting])
        self._keys = self._markings if packing.words == 1 else [int(key) for key in found.keys[waiting]]
        self._key_change = [int(change) for change in packing.key_change]
        enabled = packing.enabled(found.words[:, waiting])
        self._enabled = [tuple(np.flatnonzero(column).tolist()) for column in enabled.T]
        self._met = {marking: number for number, marking in enumerate(self._markings, start=begin)}
        self._old = begin > 0
        self._parents: list[int] = []
        self._rows: list[int] = []
        self._kinds: list[int] = []
        self._degrees: list[int] = []
        self._targets: list[int] = []
        self._fired: set[int] = set()
        self._labelled = self._edges = 0

    @property
    def count(self) -> int:
        """Number of markings found altogether."""
        return self._begin + len(self._markings)

    def expand(self, number: int) -> None:
        """Fire all enabled transitions of one marking; markings must come in order.

        Raises:
            OverflowedError: A field is too narrow; the marking counts as not expanded.
            CollisionError: Two markings have the same key; likewise.
        """
        place = number - self._begin
        marking, enabled = self._markings[place], self._enabled[place]
        targets: list[int] = []
        seen: set[int] = set()
        kinds = loops = 0
        for transition in enabled:
            kinds |= self._kinds_of[transition]
            constants = self._program[transition]
            row = constants.row
            if row < 0:
                loops = 1
                continue
            if self._shared:
                if row in seen:  # two transitions of one effect are one edge
                    continue
                seen.add(row)
            after = marking + constants.change
            target = self._met.get(after)
            if target is None:
                target = self._number(after, number, row)
            targets.append(target)
        self._enabled[place] = ()
        self._fired.update(enabled)
        self._targets += targets
        self._degrees.append(len(targets))
        self._kinds.append(kinds)
        self._labelled += len(enabled)
        self._edges += len(targets) + loops

    def _number(self, after: int, parent: int, row: int) -> int:
        if after & self._guards:
            hit = after & self._guards
            raise OverflowedError([hit >> (WORD * word) & _FULL for word in range(self._found.packing.words)])
        single = self._keys is self._markings
        key = after if single else (self._keys[parent - self._begin] + self._key_change[row]) & _FULL
        if self._old:
            number = self._found.visited.find_one(key)
            if number >= 0:
                if number < self._begin:
                    if not single and self._older(number) != after:
                        raise CollisionError
                    return number
                if not single:
                    raise CollisionError
        number = self.count
        self._met[after] = number
        self._markings.append(after)
        if not single:
            self._keys.append(key)
        near = self._near[row]
        kept = [t for t in self._enabled[parent - self._begin] if t not in near]
        self._enabled.append((*kept, *self._which(after, near)))
        self._parents.append(parent)
        self._rows.append(row)
        return number

    def _which(self, marking: int, transitions: Collection[int]) -> tuple[int, ...]:
        """Return the enabled ones of some transitions."""
        guarded = marking | self._guards
        program = self._program
        found = []
        for transition in transitions:
            amount, mask, stop_amount, stop_mask, _, _ = program[transition]
            if (guarded - amount) & mask == mask and not (stop_mask and (guarded - stop_amount) & stop_mask):
                found.append(transition)
        return tuple(found)

    def _older(self, number: int) -> int:
        return self._found.packing.to_integers(self._found.words[:, number : number + 1])[0]

    def flush(self) -> None:
        """Hand over the found markings.

        Raises:
            CollisionError: Two markings have the same key; everything was handed over, but must be hashed anew.
        """
        found = self._found
        new = slice(found.count - self._begin, None)
        words = found.packing.to_words(self._markings[new])
        keys = words[0] if found.packing.words == 1 else np.array(self._keys[new], np.uint64)
        expanded = self._begin + len(self._degrees)
        found.reserve(found.count + len(keys))
        found.kinds[self._begin : expanded] = self._kinds
        found.add_arcs(np.array(self._degrees, np.int32), np.array(self._targets, np.int32))
        found.fired[list(self._fired)] = True
        found.labelled_arcs += self._labelled
        found.distinct_edges += self._edges
        found.append(words, keys, np.array(self._parents, np.int32), np.array(self._rows, np.int32))
