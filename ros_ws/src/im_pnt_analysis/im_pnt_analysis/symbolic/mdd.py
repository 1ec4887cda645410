"""Sets of markings as multi-valued decision diagrams, a level for each place.

A node maps the tokens of its place to a node of the level below; equal nodes exist once, so that equal sets are equal
numbers. No bound of a place has to be known beforehand (Ciardo, Lüttgen and Siminiceanu, "Saturation: an efficient
iteration strategy for symbolic state-space generation", TACAS 2001).
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from im_core.clock import thread_cpu

EMPTY, UNIT = 0, 1
"""The nodes below the lowest level: no marking, and the one that is left when all places are read."""

Node = int
Pairs = tuple[tuple[int, Node], ...]
"""Tokens of the place and the node below, by rising tokens; the node below is never EMPTY."""

_CHECK_EVERY = 4_096


class GaveUpError(Exception):
    """Error: the diagram cannot be finished within the limits; the message names the met one."""


class Diagram:
    """Shared nodes of sets of markings over places in one order.

    Args:
        order: Places from the top level to the lowest one.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; None: never.
    """

    def __init__(self, order: Sequence[int], deadline: float | None = None) -> None:
        self.order = tuple(order)
        self.depth = len(self.order)
        self.level = {place: self.depth - i for i, place in enumerate(self.order)}
        self.pairs: list[Pairs] = [(), ()]
        self._deadline = deadline
        self._max_nodes = 1_500_000
        self._unique: dict[Pairs, Node] = {}
        self._unions: dict[tuple[Node, Node], Node] = {}
        self._intersections: dict[tuple[Node, Node], Node] = {}
        self._differences: dict[tuple[Node, Node], Node] = {}
        self._steps = 0

    def node(self, children: dict[int, Node]) -> Node:
        """Return the node with the given children, EMPTY where there is none.

        Raises:
            GaveUpError: A limit is met.
        """
        if not children:
            return EMPTY
        key = tuple(sorted(children.items()))
        found = self._unique.get(key)
        if found is None:
            found = self._unique[key] = len(self.pairs)
            self.pairs.append(key)
            if found > self._max_nodes:
                raise GaveUpError(f"the decision diagram has more than {self._max_nodes} nodes")
        return found

    def tick(self) -> None:
        """Count a step of work.

        Raises:
            GaveUpError: The deadline has passed.
        """
        self._steps += 1
        if self._steps % _CHECK_EVERY == 0 and self._deadline is not None and thread_cpu() > self._deadline:
            raise GaveUpError(f"the time is up with {len(self.pairs)} nodes of the decision diagram")

    @contextmanager
    def share(self, time: float, nodes: int) -> Iterator[None]:
        """Tighten the limits within the context.

        Args:
            time: Share of the time that is left.
            nodes: Nodes that may be made.
        """
        before = self._deadline, self._max_nodes
        now = thread_cpu()
        if self._deadline is not None:
            self._deadline = now + time * (self._deadline - now)
        self._max_nodes = min(self._max_nodes, len(self.pairs) + nodes)
        try:
            yield
        finally:
            self._deadline, self._max_nodes = before

    def single(self, marking: Sequence[int]) -> Node:
        """Return the set of one marking, given by place."""
        below = UNIT
        for place in reversed(self.order):
            below = self.node({marking[place]: below})
        return below

    def union(self, a: Node, b: Node) -> Node:
        """Return the markings of either set."""
        if a == b or b == EMPTY:
            return a
        if a == EMPTY:
            return b
        key = (a, b) if a < b else (b, a)
        result = self._unions.get(key)
        if result is None:
            self.tick()
            children = dict(self.pairs[a])
            for tokens, child in self.pairs[b]:
                other = children.get(tokens)
                children[tokens] = child if other is None else self.union(other, child)
            result = self._unions[key] = self.node(children)
        return result

    def intersection(self, a: Node, b: Node) -> Node:
        """Return the markings of both sets."""
        if a == b or EMPTY in (a, b):
            return a if a == b else EMPTY
        key = (a, b) if a < b else (b, a)
        result = self._intersections.get(key)
        if result is None:
            self.tick()
            others = dict(self.pairs[b])
            children = {}
            for tokens, child in self.pairs[a]:
                if (both := self.intersection(child, others.get(tokens, EMPTY))) != EMPTY:
                    children[tokens] = both
            result = self._intersections[key] = self.node(children)
        return result

    def difference(self, a: Node, b: Node) -> Node:
        """Return the markings of the first set without the markings of the second."""
        if a == b or EMPTY in (a, b):
            return EMPTY if a == b else a
        key = (a, b)
        result = self._differences.get(key)
        if result is None:
            self.tick()
            others = dict(self.pairs[b])
            children = {}
            for tokens, child in self.pairs[a]:
                if (left := self.difference(child, others.get(tokens, EMPTY))) != EMPTY:
                    children[tokens] = left
            result = self._differences[key] = self.node(children)
        return result

    def count(self, root: Node) -> int:
        """Return the number of markings of a set."""
        numbers = {EMPTY: 0, UNIT: 1}

        def count(node: Node) -> int:
            number = numbers.get(node)
            if number is None:
                self.tick()
                number = numbers[node] = sum([count(child) for _, child in self.pairs[node]])
            return number

        return count(root)

    def contains(self, root: Node, marking: Sequence[int]) -> bool:
        """Whether a marking, given by place, is in a set."""
        for place in self.order:
            root = next((child for tokens, child in self.pairs[root] if tokens == marking[place]), EMPTY)
        return root == UNIT

    def pick(self, root: Node) -> tuple[int, ...]:
        """Return a marking of a nonempty set, by place."""
        marking = [0] * self.depth
        for place in self.order:
            marking[place], root = self.pairs[root][0]
        return tuple(marking)


@contextmanager
def deep_recursion(depth: int) -> Iterator[None]:
    """Permit recursion over a number of levels of a diagram within the context."""
    before = sys.getrecursionlimit()
    sys.setrecursionlimit(max(before, 20 * depth + 1_000))
    try:
        yield
    finally:
        sys.setrecursionlimit(before)
