"""The markings met so far, looked up by key, many at a time."""

import numpy as np
import numpy.typing as npt

from im_pnt.analysis.fields import Words

Numbers = npt.NDArray[np.int32]
"""Numbers of markings in the order in which they were found."""

_ALWAYS_MERGED = 1 << 15
_RATIO = 4


class Visited:
    """Keys in a few sorted runs, each several times as long as the next, so that adding some moves few others."""

    def __init__(self) -> None:
        self._runs: list[tuple[Words, Numbers]] = []

    def __bool__(self) -> bool:
        return bool(self._runs)

    def find(self, keys: Words) -> Numbers:
        """Returns the numbers of sorted keys, -1 for those not met."""
        result = np.full(len(keys), -1, np.int32)
        for known, numbers in self._runs:
            at = known.searchsorted(keys)
            at[at == len(known)] = 0
            hit = np.flatnonzero(known[at] == keys)
            result[hit] = numbers[at[hit]]
        return result

    def find_one(self, key: int) -> int:
        """Returns the number of one key, -1 if it was not met."""
        wanted = np.uint64(key)
        for known, numbers in self._runs:
            at = int(known.searchsorted(wanted))
            if at < len(known) and known[at] == wanted:
                return int(numbers[at])
        return -1

    def add(self, keys: Words, numbers: Numbers) -> None:
        """Adds sorted keys that were not met before."""
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
