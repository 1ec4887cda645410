"""One step of breadth-first search, on a frontier in arrays."""

from collections.abc import Sequence

import numpy as np

from im_pnt_analysis.search.state_space import CollisionError, StateSpace


class OverflowedError(Exception):
    """Error: a field has become too narrow; ``guards`` are the hit guard bits, for each word."""

    def __init__(self, guards: Sequence[int]) -> None:
        super().__init__("a field is too narrow")
        self.guards = guards


def expand(found: StateSpace, begin: int, end: int, kinds: Sequence[int]) -> None:
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
            made = (word[sources] + change[rows])[order]
            alike = (made[1:] == made[:-1]) | new_key[1:]
            if not alike.all() or not np.array_equal(word[numbers], made[firsts]):
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
