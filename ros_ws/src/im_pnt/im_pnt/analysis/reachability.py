"""Exact search of the reachable markings, breadth first, so that every counterexample is a shortest one."""

from collections.abc import Callable
from dataclasses import dataclass, field

from im_core.clock import monotonic
from im_pnt.analysis.compose import Composition
from im_pnt.compiled import Compiled, compile_net

Vector = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Limits:
    """Where a search gives up.

    Attributes:
        states: Number of markings.
        seconds: Time [s].
    """

    states: int = 200_000
    seconds: float = 30.0


@dataclass(slots=True)
class Graph:
    """The reachability graph as far as it was searched.

    Attributes:
        compiled: The net in indices.
        states: Markings in the order they were found; the first is the initial one.
        parents: For each marking the marking and transition that found it; (-1, -1) for the first.
        arcs: For each searched marking its firings as pairs of transition and marking reached.
        growth: Marking that covers an earlier one on its own path, and that earlier one; None: not met.
        stopped: Why the search ended early, empty if it is complete.
    """

    compiled: Compiled
    states: list[Vector] = field(default_factory=list)
    parents: list[tuple[int, int]] = field(default_factory=list)
    arcs: list[list[tuple[int, int]]] = field(default_factory=list)
    growth: tuple[int, int] | None = None
    stopped: str = ""

    @property
    def complete(self) -> bool:
        """Whether every reachable marking was found."""
        return not self.stopped and self.growth is None

    def sequence(self, state: int, since: int = 0) -> list[str]:
        """Returns the shortest firing sequence that leads to a marking from an earlier one on its path."""
        names: list[str] = []
        while state != since and state > 0:
            state, transition = self.parents[state]
            names.append(self.compiled.transitions[transition])
        return names[::-1]

    def marking(self, state: int) -> dict[str, int]:
        """Returns the marked places of a marking."""
        return self.compiled.marking(self.states[state])


def explore(
    composition: Composition, limits: Limits | None = None, *, bounded: bool = False, start: Vector | None = None
) -> Graph:
    """Finds all markings that can be reached.

    Unboundedness is recognised on the way: on an infinite search tree some path meets a marking that covers an earlier
    one of the same path (Karp and Miller, 1969); the firings between the two can be repeated for ever.

    Args:
        composition: The net and its environment.
        limits: Where to give up.
        bounded: Known to be bounded (for instance covered by P-semiflows): growth is not looked for.
        start: Marking to start from; None: the initial one.
    """
    limits = limits or Limits()
    compiled = compile_net(composition.net)
    at_rest = at_rest_test(composition, compiled)
    rest_only = [compiled.transitions.index(name) for name in sorted(composition.at_rest_only)]
    always = [t for t in range(len(compiled.transitions)) if t not in rest_only]
    grows = None if bounded else _growth_test(composition, compiled)
    first = start if start is not None else compiled.marking_vector(composition.net.initial_marking())
    graph = Graph(compiled, [first], [(-1, -1)])
    index = {first: 0}
    deadline = monotonic() + limits.seconds
    inputs, inhibitors, fire = compiled.inputs, compiled.inhibitors, compiled.fire
    current = 0
    while current < len(graph.states):
        if current % 256 == 0 and monotonic() > deadline:
            graph.stopped = f"not finished after {limits.seconds:g} s, {len(graph.states)} markings"
            break
        vector = graph.states[current]
        arcs: list[tuple[int, int]] = []
        candidates = always + rest_only if rest_only and at_rest(vector) else always
        for transition in candidates:
            for place, weight in inputs[transition]:
                if vector[place] < weight:
                    break
            else:
                if any(vector[place] >= weight for place, weight in inhibitors[transition]):
                    continue
                after = fire(vector, transition)
                found = index.get(after)
                if found is None:
                    found = len(graph.states)
                    index[after] = found
                    graph.states.append(after)
                    graph.parents.append((current, transition))
                    if grows is not None and (ancestor := grows(graph, found)) is not None:
                        graph.growth = (ancestor, found)
                        return graph
                arcs.append((transition, found))
        graph.arcs.append(arcs)
        if len(graph.states) > limits.states:
            graph.stopped = f"more than {limits.states} markings"
            break
        current += 1
    return graph


def at_rest_test(composition: Composition, compiled: Compiled) -> Callable[[Vector], bool]:
    """Makes the test whether a marking holds tokens in rest places only."""
    busy = [i for i, name in enumerate(compiled.places) if name not in composition.rest]
    return lambda vector: not any(vector[place] for place in busy)


def _growth_test(composition: Composition, compiled: Compiled) -> Callable[[Graph, int], int | None]:
    """Makes the test that finds an ancestor which a marking covers, such that the firings between can be repeated."""
    inhibiting = [place for place, rows in enumerate(compiled.inhibited) if rows]
    busy = [i for i, name in enumerate(compiled.places) if name not in composition.rest]
    rest_only = {compiled.transitions.index(name) for name in composition.at_rest_only}

    def ancestor_covered(graph: Graph, state: int) -> int | None:
        vector = graph.states[state]
        total = sum(vector)
        needs_rest = False
        ancestor, transition = graph.parents[state]
        while ancestor >= 0:
            needs_rest = needs_rest or transition in rest_only
            earlier = graph.states[ancestor]
            if (
                sum(earlier) < total
                and all(a <= b for a, b in zip(earlier, vector, strict=True))
                and all(earlier[place] == vector[place] for place in inhibiting)
                and not (needs_rest and any(earlier[place] != vector[place] for place in busy))
            ):
                return ancestor
            ancestor, transition = graph.parents[ancestor]
        return None

    return ancestor_covered
