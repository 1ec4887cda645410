"""Questions about a set of markings in a decision diagram: enabled transitions, the counts, and next markings."""

from collections.abc import Sequence

from im_pnt_analysis.symbolic.mdd import EMPTY, UNIT, Diagram, Node
from im_pnt_analysis.symbolic.saturation import UNTOUCHED, SaturationEvent


def path_counts(diagram: Diagram, root: Node) -> list[dict[Node, int]]:
    """Return for each level the number of paths from the root to each of the nodes.

    Args:
        diagram: The diagram.
        root: A set that is not empty.
    """
    layers: list[dict[Node, int]] = [{root: 1}]
    for _ in range(diagram.depth):
        below: dict[Node, int] = {}
        for node, paths in layers[-1].items():
            for _, child in diagram.pairs[node]:
                below[child] = below.get(child, 0) + paths
        layers.append(below)
    return layers[::-1]


class MarkingSet:
    """Nonempty set of markings."""

    def __init__(self, diagram: Diagram, root: Node, events: Sequence[SaturationEvent]) -> None:
        self.diagram = diagram
        self.root = root
        self._events = tuple(events)
        self._paths = path_counts(diagram, root)
        self._sizes: dict[Node, int] = {UNIT: 1}
        for layer in self._paths[1:]:
            for node in layer:
                self._sizes[node] = sum(self._sizes[child] for _, child in diagram.pairs[node])
        self._at: list[list[int]] = [[] for _ in range(diagram.depth + 1)]
        for number, event in enumerate(self._events):
            self._at[event.highest].append(number)
        self._next: dict[Node, Node] = {EMPTY: EMPTY, UNIT: EMPTY}
        self._images: dict[tuple[int, Node], Node] = {}

    def size(self) -> int:
        """Return the number of markings of the set."""
        return self._sizes[self.root]

    def place_bounds(self) -> list[int]:
        """Return for each place the most tokens in the set."""
        most = [0] * self.diagram.depth
        for level, place in enumerate(reversed(self.diagram.order), start=1):
            most[place] = max(self.diagram.pairs[node][-1][0] for node in self._paths[level])
        return most

    def most_tokens(self) -> int:
        """Return the most tokens of a marking of the set."""
        most = {UNIT: 0}
        for level in range(1, self.diagram.depth + 1):
            for node in self._paths[level]:
                most[node] = max([tokens + most[child] for tokens, child in self.diagram.pairs[node]])
        return most[self.root]

    def enabled_count(self, transition: int) -> int:
        """Return the number of markings of the set enabling a transition."""
        event = self._events[transition]
        known: dict[Node, int] = {}

        def count(node: Node, level: int) -> int:
            if level < event.lowest or level == 0:
                return self._sizes[node]
            number = known.get(node)
            if number is None:
                self.diagram.tick()
                low, high, _ = event.steps[level] or UNTOUCHED
                number = sum(
                    [count(child, level - 1) for tokens, child in self.diagram.pairs[node] if low <= tokens < high]
                )
                known[node] = number
            return number

        return sum(paths * count(node, event.highest) for node, paths in self._paths[event.highest].items())

    def where_enabled(self, transition: int) -> Node:
        """Return the markings of the set enabling a transition."""
        return self._restrict(self.root, self.diagram.depth, transition, {}, enabled=True)

    def where_disabled(self, transitions: Sequence[int]) -> Node:
        """Return the markings of the set enabling none of the given transitions."""
        node = self.root
        for transition in transitions:
            node = self._restrict(node, self.diagram.depth, transition, {}, enabled=False)
        return node

    def dead(self) -> Node:
        """Return the dead markings of the set."""
        memos: list[dict[Node, Node]] = [{} for _ in self._events]
        known: dict[Node, Node] = {EMPTY: EMPTY}

        def dead(node: Node, level: int) -> Node:
            result = known.get(node)
            if result is None:
                result = node
                if level > 0:
                    children = {tokens: dead(child, level - 1) for tokens, child in self.diagram.pairs[node]}
                    result = self.diagram.node({tokens: child for tokens, child in children.items() if child != EMPTY})
                for transition in self._at[level]:
                    result = self._restrict(result, level, transition, memos[transition], enabled=False)
                known[node] = result
            return result

        return dead(self.root, self.diagram.depth)

    def _restrict(self, node: Node, level: int, transition: int, known: dict[Node, Node], *, enabled: bool) -> Node:
        event = self._events[transition]
        if node == EMPTY:
            return EMPTY
        if level < event.lowest or level == 0:
            return node if enabled else EMPTY
        result = known.get(node)
        if result is None:
            self.diagram.tick()
            low, high, _ = event.steps[level] or UNTOUCHED
            children = {}
            for tokens, child in self.diagram.pairs[node]:
                if low <= tokens < high:
                    child = self._restrict(child, level - 1, transition, known, enabled=enabled)
                elif enabled:
                    continue
                if child != EMPTY:
                    children[tokens] = child
            result = known[node] = self.diagram.node(children)
        return result

    def image(self, node: Node, level: int | None = None) -> Node:
        """Return the markings one firing after a set of the diagram."""
        level = self.diagram.depth if level is None else level
        result = self._next.get(node)
        if result is None:
            self.diagram.tick()
            children = {tokens: self.image(child, level - 1) for tokens, child in self.diagram.pairs[node]}
            result = self.diagram.node({tokens: child for tokens, child in children.items() if child != EMPTY})
            for transition in self._at[level]:
                result = self.diagram.union(result, self._fired(node, level, transition))
            self._next[node] = result
        return result

    def _fired(self, node: Node, level: int, transition: int) -> Node:
        event = self._events[transition]
        if level < event.lowest or level == 0:
            return node
        key = (transition, node)
        result = self._images.get(key)
        if result is None:
            self.diagram.tick()
            low, high, change = event.steps[level] or UNTOUCHED
            children = {
                tokens + change: self._fired(child, level - 1, transition)
                for tokens, child in self.diagram.pairs[node]
                if low <= tokens < high
            }
            result = self.diagram.node({tokens: child for tokens, child in children.items() if child != EMPTY})
            self._images[key] = result
        return result
