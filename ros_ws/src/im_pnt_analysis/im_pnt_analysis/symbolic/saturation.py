"""Reachable markings, forward or backward, by saturation of a decision diagram.

Each node is brought to its fixed point under the transitions whose highest place is its own before anything above it is
looked at, so that intermediate sets stay small (Ciardo, Lüttgen and Siminiceanu, 2001). Backward search stays within a
given set (constrained saturation; Zhao and Ciardo, ATVA 2009).
"""

from collections.abc import Sequence
from typing import NamedTuple

from im_pnt.model.compiled import Compiled
from im_pnt_analysis.symbolic.mdd import EMPTY, UNIT, Diagram, GaveUpError, Node


class LevelEffect(NamedTuple):
    """Condition and effect of a transition at a place: the transition fires at low <= tokens < high."""

    low: int
    high: float
    change: int


UNTOUCHED = LevelEffect(0, float("inf"), 0)
"""Of a place that a transition does not touch."""


class SaturationEvent(NamedTuple):
    """Transition in levels; an untouched level is None."""

    lowest: int
    highest: int
    steps: tuple[LevelEffect | None, ...]


def saturation_event(
    compiled: Compiled, diagram: Diagram, transition: int, *, backward: bool = False
) -> SaturationEvent:
    """Make the event of a transition.

    Args:
        compiled: The net.
        diagram: The diagram, whose levels it uses.
        transition: The transition.
        backward: Whether to undo it instead: from a marking to the one before.
    """
    steps: list[LevelEffect | None] = [None] * (diagram.depth + 1)
    low = dict(compiled.inputs[transition])
    high = dict(compiled.inhibitors[transition])
    change = dict(compiled.change[transition])
    touched = low.keys() | high.keys() | change.keys()
    for place in touched:
        step = LevelEffect(low.get(place, 0), high.get(place, float("inf")), change.get(place, 0))
        if backward:
            step = LevelEffect(step.low + step.change, step.high + step.change, -step.change)
        steps[diagram.level[place]] = step
    levels = [diagram.level[place] for place in touched]
    return SaturationEvent(min(levels, default=0), max(levels, default=0), tuple(steps))


class Saturation:
    """Closes sets of markings under a set of transitions.

    Args:
        diagram: The diagram.
        events: The transitions; those that change nothing are left out.
        within: Set that is never left; None: all markings.
        most: For each place the number of tokens at which the net counts as growing without end; None: any number.
    """

    def __init__(
        self,
        diagram: Diagram,
        events: Sequence[SaturationEvent],
        within: Node | None = None,
        most: Sequence[int | None] | None = None,
    ) -> None:
        self._diagram = diagram
        self._events = [event for event in events if any(step and step.change for step in event.steps)]
        self._at: list[list[int]] = [[] for _ in range(diagram.depth + 1)]
        for number, event in enumerate(self._events):
            self._at[event.highest].append(number)
        self._within = within
        self._most = [None, *(None if most is None else most[place] for place in reversed(diagram.order))]
        self._saturated: dict[tuple[int, Node, Node], Node] = {}
        self._fired: dict[tuple[int, Node, Node], Node] = {}
        self._closed: dict[tuple[Node, Node], Node] = {}
        self._children: dict[Node, dict[int, Node]] = {}

    def close(self, start: Node) -> Node:
        """Return the markings reachable from the markings of a set, including the set.

        Raises:
            GaveUpError: A limit of the diagram is met, or a place grows without end.
        """
        return self._close(start, self._within if self._within is not None else UNIT, self._diagram.depth)

    def _close(self, node: Node, within: Node, level: int) -> Node:
        if level == 0 or node == EMPTY:
            return node
        key = (node, within)
        result = self._closed.get(key)
        if result is None:
            children = {}
            for tokens, child in self._diagram.pairs[node]:
                allowed = self._allowed(within, tokens)
                if allowed != EMPTY and (closed := self._close(child, allowed, level - 1)) != EMPTY:
                    children[tokens] = closed
            result = self._closed[key] = self._saturate(children, within, level) if children else EMPTY
        return result

    def _allowed(self, within: Node, tokens: int) -> Node:
        """Return the node below in the invariant set; UNIT stands for any marking without such a set."""
        if self._within is None:
            return UNIT
        children = self._children.get(within)
        if children is None:
            children = self._children[within] = dict(self._diagram.pairs[within])
        return children.get(tokens, EMPTY)

    def _saturate(self, children: dict[int, Node], within: Node, level: int) -> Node:
        diagram = self._diagram
        before = diagram.node(children)
        key = (level, before, within)
        known = self._saturated.get(key)
        if known is not None:
            return known
        most = self._most[level]
        pending = {number: set(children) for number in self._at[level]}
        busy = bool(pending)
        while busy:
            busy = False
            for number, work in pending.items():
                step = self._events[number].steps[level]
                assert step is not None
                while work:
                    busy = True
                    diagram.tick()
                    tokens = work.pop()
                    after = tokens + step.change
                    if not step.low <= tokens < step.high or (allowed := self._allowed(within, after)) == EMPTY:
                        continue
                    found = self._fire(number, children[tokens], allowed, level - 1)
                    old = children.get(after, EMPTY)
                    new = diagram.union(old, found)
                    if new != old:
                        children[after] = new
                        for others in pending.values():  # a new marking may enable any event of the level again
                            others.add(after)
                        if most is not None and after > most:
                            raise GaveUpError(f"a place of unknown bound gets more than {most} tokens")
        result = self._saturated[key] = diagram.node(children)
        return result

    def _fire(self, number: int, node: Node, within: Node, level: int) -> Node:
        event = self._events[number]
        if level < event.lowest:
            return node if self._within is None else self._diagram.intersection(node, within)
        key = (number, node, within)
        known = self._fired.get(key)
        if known is not None:
            return known
        diagram = self._diagram
        diagram.tick()
        step = event.steps[level] or UNTOUCHED
        low, high, change = step
        children = {}
        for tokens, child in diagram.pairs[node]:
            if low <= tokens < high:
                allowed = self._allowed(within, tokens + change)
                if allowed != EMPTY and (found := self._fire(number, child, allowed, level - 1)) != EMPTY:
                    children[tokens + change] = found
        result = self._fired[key] = self._saturate(children, within, level) if children else EMPTY
        return result
