"""Which transitions are enabled, kept up to date by what a firing changes and nothing else.

Each transition counts its unmet inputs; a place that crosses an arc's weight changes the counters of its neighbours
only, so that the cost of a firing does not grow with the net.
"""

from collections import deque
from collections.abc import Collection

from im_pnt.compiled import Compiled


class Enabling:
    """Tokens, counters of unmet inputs, and the conflict sets that are worth a decision.

    Args:
        compiled: The expanded net.
        free: Transitions that fire when enabled; the others (end, failed, withdrawn) wait for an event.
        tokens: Tokens of each place to begin with.
    """

    def __init__(self, compiled: Compiled, free: Collection[int], tokens: Collection[int]) -> None:
        self.compiled = compiled
        self.tokens = [0] * len(compiled.places)
        self.unmet = [len(inputs) for inputs in compiled.inputs]
        self._free = frozenset(free)
        self.members, self.conflict_set = _conflict_sets(compiled, sorted(self._free))
        self._agenda: deque[int] = deque()
        self._listed = [False] * len(self.members)
        for place, count in enumerate(tokens):
            self.add(place, count)
        for transition in self._free:
            if not self.unmet[transition]:
                self.consider(self.conflict_set[transition])

    def add(self, place: int, count: int) -> None:
        """Puts tokens on a place."""
        before = self.tokens[place]
        after = before + count
        self.tokens[place] = after
        unmet = self.unmet
        for transition, weight in self.compiled.consumers[place]:
            if before < weight <= after:
                unmet[transition] -= 1
            if not unmet[transition] and transition in self._free:
                self.consider(self.conflict_set[transition])
        for transition, weight in self.compiled.inhibited[place]:
            if before < weight <= after:
                unmet[transition] += 1

    def take(self, place: int, count: int) -> None:
        """Takes tokens from a place that has them."""
        before = self.tokens[place]
        after = before - count
        self.tokens[place] = after
        unmet = self.unmet
        for transition, weight in self.compiled.consumers[place]:
            if after < weight <= before:
                unmet[transition] += 1
        for transition, weight in self.compiled.inhibited[place]:
            if after < weight <= before:
                unmet[transition] -= 1
                if not unmet[transition] and transition in self._free:
                    self.consider(self.conflict_set[transition])

    def consider(self, conflict_set: int) -> None:
        """Asks for a decision about a conflict set."""
        if not self._listed[conflict_set]:
            self._listed[conflict_set] = True
            self._agenda.append(conflict_set)

    def next_decision(self) -> int | None:
        """Takes the next conflict set to decide about, None where there is none."""
        if not self._agenda:
            return None
        conflict_set = self._agenda.popleft()
        self._listed[conflict_set] = False
        return conflict_set

    @property
    def pending(self) -> bool:
        """Whether a decision is due."""
        return bool(self._agenda)

    def enabled(self, conflict_set: int) -> list[int]:
        """Returns the transitions of a conflict set that are enabled by their arcs."""
        unmet = self.unmet
        return [transition for transition in self.members[conflict_set] if not unmet[transition]]


def _conflict_sets(compiled: Compiled, free: list[int]) -> tuple[list[list[int]], dict[int, int]]:
    """Groups transitions that share an input place, directly or through others."""
    leader = {transition: transition for transition in free}

    def find(transition: int) -> int:
        while leader[transition] != transition:
            leader[transition] = leader[leader[transition]]
            transition = leader[transition]
        return transition

    for rows in compiled.consumers:
        sharing = [transition for transition, _ in rows if transition in leader]
        for transition in sharing[1:]:
            leader[find(transition)] = find(sharing[0])
    groups: dict[int, list[int]] = {}
    for transition in free:
        groups.setdefault(find(transition), []).append(transition)
    members = list(groups.values())
    return members, {transition: number for number, group in enumerate(members) for transition in group}
