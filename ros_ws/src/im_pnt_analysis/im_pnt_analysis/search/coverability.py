"""Reachable and coverable markings of unbounded nets (Karp and Miller, 1969).

A marking that covers an earlier one on its own path shows that the firings between can be repeated for ever: the places
that have gained then count as holding any number (omega). A marking is not pursued if one at least as large is kept;
no marking that was pursued is ever dropped, which keeps the tree complete.

Places with inhibitor arcs must hold equally many tokens wherever markings are compared. The answers stay true with
that; only the search need not end where such a place itself grows.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from operator import le

import numpy as np
from numpy.typing import NDArray

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled


class Antichain:
    """Vectors without mutual cover; each has the number of the owner.

    Args:
        size: Length of the vectors; their components are below 2**53 or infinite.
    """

    def __init__(self, size: int) -> None:
        self._columns = np.zeros((size, 64))
        self._owners = np.zeros(64, np.int64)
        self._count = 0

    def covers(self, vector: Sequence[float]) -> bool:
        """Whether a vector is at most as large as one of the set, in every component."""
        rows: NDArray[np.intp] = np.arange(self._count)
        for component, value in enumerate(vector):
            if value > 0 and rows.size:
                rows = rows[self._columns[component][rows] >= value]
        return rows.size > 0

    def add(self, vector: Sequence[float], owner: int) -> list[int]:
        """Add an uncovered vector. Return the owners of the vectors now covered and removed."""
        rows = np.arange(self._count)
        for component, value in enumerate(vector):
            if value != np.inf and rows.size:
                rows = rows[self._columns[component][rows] <= value]
        covered = [int(self._owners[row]) for row in rows]
        for row in rows[::-1]:
            self._count -= 1
            self._columns[:, row] = self._columns[:, self._count]
            self._owners[row] = self._owners[self._count]
        if self._count == self._columns.shape[1]:
            self._columns = np.concatenate([self._columns, np.zeros_like(self._columns)], axis=1)
            self._owners = np.concatenate([self._owners, np.zeros_like(self._owners)])
        self._columns[:, self._count] = vector
        self._owners[self._count] = owner
        self._count += 1
        return covered


OMEGA = float("inf")
Label = tuple[float, ...]
"""Tokens of each place; OMEGA where it can hold any number at the same time."""

_LARGEST = 2**50


@dataclass(frozen=True, slots=True)
class Coverability:
    """Coverable markings; None where the search ended before.

    Attributes:
        complete: Whether the search went to its end.
        bounded: Whether no place can grow without end.
        unbounded_places: Places that can; without ``complete`` those found so far.
        place_bounds: Most tokens of each bounded place; exact.
        max_token_per_marking: Most tokens of a marking of a bounded net.
        never_enabled: Transitions that can never fire.
        sequence: Where the net is unbounded: transitions to fire first,
        repeat: and those that can then be repeated for ever, each time with more tokens.
        growing: Places that gain tokens with each repetition.
        labels: Number of markings with omegas that were made.
        reason: Why the search is not complete, empty if it is.
    """

    complete: bool
    bounded: bool | None = None
    unbounded_places: tuple[str, ...] = ()
    place_bounds: dict[str, int] | None = None
    max_token_per_marking: int | None = None
    never_enabled: tuple[str, ...] | None = None
    sequence: tuple[str, ...] = ()
    repeat: tuple[str, ...] = ()
    growing: tuple[str, ...] = ()
    labels: int = 0
    reason: str = ""


def coverability(
    compiled: Compiled, initial: tuple[int, ...], deadline: float | None = None, max_nodes: int = 100_000
) -> Coverability:
    """Build the tree of coverable markings.

    Args:
        compiled: The net.
        initial: Initial marking, tokens of each place.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; None: never.
        max_nodes: Number of markings at which to give up.
    """
    tree = _Tree(compiled, tuple(initial))
    reason = tree.grow(deadline, max_nodes)
    return tree.answers(reason)


@dataclass(slots=True)
class _Node:
    label: Label
    parent: "_Node | None"
    transition: int
    total: float
    pursued: bool = True


class _Tree:
    def __init__(self, compiled: Compiled, initial: tuple[int, ...]) -> None:
        self.compiled = compiled
        self.tested = [place for place, rows in enumerate(compiled.inhibited) if rows]
        self.nodes: list[_Node] = []
        self.seen: set[Label] = set()
        self.largest: dict[Label, Antichain] = {}
        self.growth: tuple[_Node, _Node, Label] | None = None
        self.fired: set[int] = set()
        self._add(_Node(initial, None, -1, sum(initial)))

    def grow(self, deadline: float | None, max_nodes: int) -> str:
        """Pursue markings until none is left. Return the reason of an earlier stop, or nothing."""
        queue = deque([self.nodes[0]])
        steps = 0
        while queue:
            # one in breadth, for short sequences, one in depth, for growth that appears only there
            node = queue.popleft() if steps % 2 else queue.pop()
            steps += 1
            if deadline is not None and thread_cpu() > deadline:
                return f"the time is up after {len(self.nodes)} markings"
            if len(self.nodes) > max_nodes:
                return f"more than {max_nodes} markings"
            if any(_LARGEST < tokens < OMEGA for tokens in node.label):
                return f"a place holds more than {_LARGEST} tokens"
            if node.pursued:
                queue.extend(self._following(node))
        return ""

    def _following(self, node: _Node) -> list[_Node]:
        compiled = self.compiled
        enabled = [number for number in range(len(compiled.transitions)) if _enabled(compiled, node.label, number)]
        self.fired.update(enabled)
        kept = []
        for transition in enabled:
            after = list(node.label)
            for place, change in compiled.change[transition]:
                after[place] += change
            following = _Node(tuple(after), node, transition, sum(after))
            self._accelerate(following)
            if self._add(following):
                kept.append(following)
        return kept

    def _add(self, node: _Node) -> bool:
        """Keep a node without a covering one; drop nodes covered by the new one from the search."""
        if node.label in self.seen:
            return False
        self.seen.add(node.label)
        key = tuple(node.label[place] for place in self.tested)
        if key not in self.largest:
            self.largest[key] = Antichain(len(node.label))
        if self.largest[key].covers(node.label):
            return False
        for covered in self.largest[key].add(node.label, len(self.nodes)):
            self.nodes[covered].pursued = False
        self.nodes.append(node)
        return True

    def _accelerate(self, node: _Node) -> None:
        earlier = node.parent
        while earlier is not None:
            if (
                (earlier.total < node.total or node.total == OMEGA)
                and all(map(le, earlier.label, node.label))
                and all(earlier.label[place] == node.label[place] for place in self.tested)
            ):
                gained = tuple(
                    OMEGA if before < now else now for before, now in zip(earlier.label, node.label, strict=True)
                )
                if gained != node.label:
                    if self.growth is None:
                        self.growth = (earlier, node, gained)
                    node.label, node.total = gained, OMEGA
            earlier = earlier.parent

    def answers(self, reason: str) -> Coverability:
        compiled = self.compiled
        most = [max(column) for column in zip(*(node.label for node in self.nodes), strict=True)]
        unbounded = tuple(name for name, tokens in zip(compiled.places, most, strict=True) if tokens == OMEGA)
        sequence: tuple[str, ...] = ()
        repeat: tuple[str, ...] = ()
        growing: tuple[str, ...] = ()
        if self.growth is not None:
            earlier, later, label = self.growth
            sequence = tuple(self._path(earlier))
            repeat = tuple(self._path(later))[len(sequence) :]
            growing = tuple(name for name, tokens in zip(compiled.places, label, strict=True) if tokens == OMEGA)
        complete = not reason
        never = tuple(name for number, name in enumerate(compiled.transitions) if number not in self.fired)
        return Coverability(
            complete,
            False if unbounded else (True if complete else None),
            unbounded,
            {name: int(tokens) for name, tokens in zip(compiled.places, most, strict=True) if tokens != OMEGA}
            if complete
            else None,
            int(max(sum(node.label) for node in self.nodes)) if complete and not unbounded else None,
            never if complete or not never else None,
            sequence,
            repeat,
            growing,
            len(self.nodes),
            reason,
        )

    def _path(self, node: _Node) -> list[str]:
        names: list[str] = []
        while node.parent is not None:
            names.append(self.compiled.transitions[node.transition])
            node = node.parent
        return names[::-1]


def _enabled(compiled: Compiled, label: Label, transition: int) -> bool:
    return all(label[place] >= weight for place, weight in compiled.inputs[transition]) and all(
        label[place] < weight for place, weight in compiled.inhibitors[transition]
    )
