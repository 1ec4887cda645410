"""Exact answers about state spaces too large to list, from decision diagrams built by saturation."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from im_pnt.model.compiled import Compiled
from im_pnt_analysis.search.stubborn import find_deadlock
from im_pnt_analysis.symbolic.marking_set import MarkingSet
from im_pnt_analysis.symbolic.mdd import EMPTY, Diagram, GaveUpError, Node, deep_recursion
from im_pnt_analysis.symbolic.saturation import Saturation, saturation_event
from im_pnt_analysis.symbolic.variable_order import place_order

_GROWTH = 10_000
_RINGS_TIME, _RINGS_NODES = 0.4, 300_000
"""What the search for a shortest way to a deadlock may use: share of the time left, and nodes."""
_SEARCHED = 300_000
"""Markings that the search for any other way may list."""
_Answer = TypeVar("_Answer")


@dataclass(slots=True)
class SymbolicAnswers:
    """Answers about all reachable markings; None where one was not obtained, with the reason in ``unknown``.

    Attributes:
        states: Number of reachable markings.
        place_bounds: Most tokens of each place.
        max_token_per_marking: Most tokens of a marking.
        has_deadlock: Whether a marking without an enabled transition is reachable.
        deadlock_states: Number of such markings.
        deadlock_sequence: Firing sequence to one of them, a shortest one unless that takes too long; None also where
            there is none.
        deadlock_marking: A marking without an enabled transition, the one that the sequence leads to if there is one.
        never_enabled: Transitions that are enabled in no reachable marking.
        arcs: Number of firings, one for each reachable marking and transition enabled there.
        distinct_edges: Number of pairs of a marking and a marking that one firing makes of it.
        reversible: Whether the initial marking can be reached again from every reachable marking.
        live_transitions: Transitions that can always be enabled again.
        live: Whether all transitions can.
        nodes: Nodes of the decision diagram that were made.
        unknown: For each answer that is missing the reason.
    """

    states: int | None = None
    place_bounds: dict[str, int] | None = None
    max_token_per_marking: int | None = None
    has_deadlock: bool | None = None
    deadlock_states: int | None = None
    deadlock_sequence: tuple[str, ...] | None = None
    deadlock_marking: dict[str, int] | None = None
    never_enabled: tuple[str, ...] | None = None
    arcs: int | None = None
    distinct_edges: int | None = None
    reversible: bool | None = None
    live_transitions: tuple[str, ...] | None = None
    live: bool | None = None
    nodes: int = 0
    unknown: dict[str, str] = field(default_factory=dict)


def explore(
    compiled: Compiled,
    initial: tuple[int, ...],
    bounds: Mapping[str, int | None] | None = None,
    deadline: float | None = None,
) -> SymbolicAnswers:
    """Find all reachable markings, and answer the questions about the markings.

    Args:
        compiled: The net; inhibitor arcs are exact.
        initial: Initial marking, tokens of each place.
        bounds: Known upper bounds of the places; where one has none, 10,000 tokens end the search.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; None: never.
    """
    with deep_recursion(len(compiled.places)):
        return _Explorer(compiled, initial, bounds or {}, deadline).answers()


class _Explorer:
    def __init__(
        self, compiled: Compiled, initial: tuple[int, ...], bounds: Mapping[str, int | None], deadline: float | None
    ) -> None:
        self.compiled = compiled
        self.initial = initial
        self.deadline = deadline
        self.diagram = Diagram(place_order(compiled), deadline)
        self.transitions = range(len(compiled.transitions))
        self.most = [_GROWTH if bounds.get(place) is None else None for place in compiled.places]
        self.result = SymbolicAnswers()

    def answers(self) -> SymbolicAnswers:
        events = [saturation_event(self.compiled, self.diagram, transition) for transition in self.transitions]

        def reach() -> MarkingSet:
            first = self.diagram.single(self.initial)
            return MarkingSet(self.diagram, Saturation(self.diagram, events, most=self.most).close(first), events)

        everything = tuple(name for name in SymbolicAnswers.__slots__ if name not in ("nodes", "unknown"))
        region = self._ask(reach, *everything)
        if region is not None:
            self._ask(lambda: self._bounds(region), "place_bounds", "max_token_per_marking")
            self._ask(lambda: self._firings(region), "never_enabled", "arcs", "distinct_edges")
            self._ask(lambda: self._deadlocks(region), "has_deadlock", "deadlock_states", "deadlock_sequence")
            self._ask(lambda: self._reversible(region), "reversible")
            self._ask(lambda: self._live(region), "live", "live_transitions")
        self.result.nodes = len(self.diagram.pairs)
        return self.result

    def _ask(self, work: Callable[[], _Answer], *answers: str) -> _Answer | None:
        try:
            return work()
        except GaveUpError as error:
            self.result.unknown.update({name: str(error) for name in answers if getattr(self.result, name) is None})
            return None

    def _bounds(self, region: MarkingSet) -> None:
        self.result.states = region.size()
        self.result.place_bounds = dict(zip(self.compiled.places, region.place_bounds(), strict=True))
        self.result.max_token_per_marking = region.most_tokens()

    def _firings(self, region: MarkingSet) -> None:
        compiled = self.compiled
        counts = [region.enabled_count(transition) for transition in self.transitions]
        self.result.arcs = sum(counts)
        self.result.never_enabled = tuple(compiled.transitions[t] for t in self.transitions if not counts[t])
        alike: dict[frozenset[tuple[int, int]], list[int]] = {}
        for transition in self.transitions:
            alike.setdefault(frozenset(compiled.change[transition]), []).append(transition)
        edges = 0
        for group in alike.values():
            if len(group) == 1:
                edges += counts[group[0]]
            else:
                edges += region.size() - self.diagram.count(region.where_disabled(group))
        self.result.distinct_edges = edges

    def _deadlocks(self, region: MarkingSet) -> None:
        dead = region.dead()
        self.result.deadlock_states = self.diagram.count(dead)
        self.result.has_deadlock = dead != EMPTY
        if dead != EMPTY:
            self.result.deadlock_marking = self.compiled.marking(self.diagram.pick(dead))
            self._deadlock_sequence(region, dead)

    def _deadlock_sequence(self, region: MarkingSet, dead: Node) -> None:
        try:
            with self.diagram.share(_RINGS_TIME, _RINGS_NODES):
                sequence, marking = self._shortest(region, dead)
        except GaveUpError as error:
            found = find_deadlock(self.compiled, self.initial, self.deadline, _SEARCHED)
            if not found.found:
                self.result.unknown["deadlock_sequence"] = f"{error}; {found.reason}"
                return
            sequence, marking = found.sequence, found.marking
        self.result.deadlock_sequence = sequence
        self.result.deadlock_marking = self.compiled.marking(marking)

    def _shortest(self, region: MarkingSet, dead: Node) -> tuple[tuple[str, ...], tuple[int, ...]]:
        """Go forward in rings of equal distance up to a dead marking, and back through the rings."""
        rings = [self.diagram.single(self.initial)]
        seen = rings[0]
        while self.diagram.intersection(rings[-1], dead) == EMPTY:
            rings.append(self.diagram.difference(region.image(rings[-1]), seen))
            seen = self.diagram.union(seen, rings[-1])
        marking = last = self.diagram.pick(self.diagram.intersection(rings.pop(), dead))
        names: list[str] = []
        while rings:
            transition, marking = self._step_back(rings.pop(), marking)
            names.append(self.compiled.transitions[transition])
        return tuple(reversed(names)), last

    def _step_back(self, ring: Node, marking: tuple[int, ...]) -> tuple[int, tuple[int, ...]]:
        for transition in self.transitions:
            before = list(marking)
            for place, change in self.compiled.change[transition]:
                before[place] -= change
            earlier = tuple(before)
            if (
                min(earlier, default=0) >= 0
                and self.compiled.enabled(earlier, transition)
                and self.diagram.contains(ring, earlier)
            ):
                return transition, earlier
        raise AssertionError("a marking has no predecessor in the last ring of the search")

    def _backward(self, region: MarkingSet) -> Saturation:
        undone = [
            saturation_event(self.compiled, self.diagram, transition, backward=True) for transition in self.transitions
        ]
        return Saturation(self.diagram, undone, within=region.root)

    def _reversible(self, region: MarkingSet) -> None:
        if self.result.has_deadlock:
            self.result.reversible = region.size() == 1
            return
        first = self.diagram.single(self.initial)
        self.result.reversible = self._backward(region).close(first) == region.root

    def _live(self, region: MarkingSet) -> None:
        names = self.compiled.transitions
        never = self.result.never_enabled
        if self.result.has_deadlock:
            live: tuple[str, ...] = ()
        elif self.result.reversible and never is not None:
            live = tuple(name for name in names if name not in set(never))
        else:
            search = self._backward(region)
            live = tuple(
                names[transition]
                for transition in self.transitions
                if search.close(region.where_enabled(transition)) == region.root
            )
        self.result.live_transitions = live
        self.result.live = len(live) == len(names)
