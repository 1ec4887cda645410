"""Answers by every reachable marking and every firing between the markings."""

from collections.abc import Collection, Sequence

import numpy as np

from im_pnt_analysis.search.digraph import Components, Mask, components, reaching
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.search.state_space import StateSpace

_CHUNK = 1 << 14


class ReachabilityGraph:
    """The reachability graph of a finished search.

    Args:
        search: The search; complete.
    """

    def __init__(self, search: Search) -> None:
        self._found = search.found
        self.begins, self.targets = self._found.arcs()
        self.components: Components = components(self.begins, self.targets)

    @property
    def reversible(self) -> bool:
        """Whether the first marking can be reached from every marking."""
        return self.components.count == 1

    @property
    def terminal_sccs(self) -> int:
        """Number of strongly connected components without a way out."""
        return int(np.count_nonzero(self.components.terminal))

    def live_transitions(self) -> list[bool]:
        """Return for each transition whether the transition can be enabled again from every marking."""
        if self.reversible:
            return [bool(fired) for fired in self._found.fired]
        label, terminal = self.components.label, self.components.terminal
        final = np.flatnonzero(terminal[label])
        transitions = len(self._found.fired)
        offering: list[set[int]] = [set() for _ in range(transitions)]
        for begin in range(0, len(final), _CHUNK):
            part = final[begin : begin + _CHUNK]
            enabled = self._found.packing.enabled(self._found.words[:, part])
            if not enabled.any(axis=0).all():
                return [False] * transitions
            for transition in np.flatnonzero(enabled.any(axis=1)).tolist():
                offering[transition].update(np.unique(label[part[enabled[transition]]]).tolist())
        return [len(found) == self.terminal_sccs for found in offering]

    def regains(self, place: int, tokens: int) -> bool:
        """Return whether a place can regain a number of tokens from every marking."""
        if self.reversible:
            return True
        label, terminal = self.components.label, self.components.terminal
        final = np.flatnonzero(terminal[label])
        enough = self._found.packing.holds(self._found.words[:, final], place, tokens)
        regained = ~terminal
        regained[label[final[enough]]] = True
        return bool(regained.all())

    def always_reaches(self, goal: Mask) -> bool:
        """Whether from every marking one of a set can be reached."""
        if self.reversible:
            return bool(goal.any())
        reached = ~self.components.terminal
        reached[self.components.label[np.flatnonzero(goal)]] = True
        return bool(reached.all())

    def first_without_return(self, goal: Mask) -> int:
        """Return the first marking without a path to any of a set."""
        return int(np.argmin(reaching(self.begins, self.targets, goal)))

    def where_one_is_enabled(self, transitions: Sequence[int]) -> Mask:
        """Return the markings with at least one of some transitions enabled."""
        found, which = self._found, list(transitions)
        parts = [
            found.packing.enabled(found.words[:, begin : min(begin + _CHUNK, found.count)])[which].any(axis=0)
            for begin in range(0, found.count, _CHUNK)
        ]
        return np.concatenate(parts)

    def where_marked(self, place: int, tokens: int) -> Mask:
        """Return the markings in which a place holds a number of tokens."""
        found = self._found
        return found.packing.holds(found.words[:, : found.count], place, tokens)


def stuck(search: Search, busy: Collection[int], *, may_end: bool) -> list[int]:
    """Return the expanded markings of a stuck net: nothing fires without an event, and the net is not at rest.

    Args:
        search: A search whose kinds are 1 for what a net does by itself and 2 for what it may wait for.
        busy: Places that hold no token at rest.
        may_end: Whether it may come to an end at rest, where it waits for nothing.
    """
    found = search.found
    kinds = found.kinds[: search.expanded]
    quiet = np.flatnonzero((kinds & 1) == 0)
    resting = np.full(len(quiet), fill_value=True) if may_end else (kinds[quiet] & 2) != 0
    words = found.words[:, quiet]
    for place in busy:
        if not resting.any():
            break
        resting &= ~found.packing.holds(words, place, 1)
    result: list[int] = quiet[~resting].tolist()
    return result


def place_bounds(found: StateSpace) -> tuple[list[int], int]:
    """Return the most tokens of each place, and of a marking, among the markings found."""
    packing, units = found.packing, found.units
    places = range(len(packing.fields))
    most = [0] * len(places)
    parts = [slice(begin, min(begin + _CHUNK, found.count)) for begin in range(0, found.count, _CHUNK)]
    for part in parts:
        for place in places:
            most[place] = max(most[place], int(packing.column(found.words[:, part], place).max()))
    bounds = [units.tokens(place, most[place]) for place in places]
    kind = np.uint64 if sum(bounds) < 1 << 63 else object
    most_in_marking = 0
    for part in parts:
        total = np.zeros(part.stop - part.start, kind)
        for place in places:
            if most[place]:
                total += packing.column(found.words[:, part], place).astype(kind, copy=False) * units.step[place]
        most_in_marking = max(most_in_marking, int(total.max()))
    return bounds, most_in_marking + sum(units.rest)
