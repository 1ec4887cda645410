"""Reasons against running nets, each with the shortest firing sequence."""

from collections.abc import Iterator

from im_pnt.verification import Counterexample
from im_pnt_analysis.search.growth import Growth
from im_pnt_analysis.search.reachability_graph import ReachabilityGraph
from im_pnt_analysis.search.state_space import StateSpace
from im_pnt_analysis.structure.siphons import emptied_siphon
from im_pnt_analysis.verify.problem import WAITS, Problem

_NAMED_PLACES = 8


def growth(found: StateSpace, grown: Growth) -> Counterexample:
    """Describe unbounded places, and the way to the growth."""
    earlier, later = found.vector(grown.earlier), found.vector(grown.later)
    names = [name for name, a, b in zip(found.compiled.places, earlier, later, strict=True) if b > a]
    return Counterexample(
        "growth",
        f"place {', '.join(names)} can grow without end",
        found.sequence(grown.earlier),
        found.marking(grown.later),
        found.sequence(grown.later, grown.earlier),
    )


def overflow(problem: Problem, found: StateSpace, *, emptied: bool = False) -> Counterexample | None:
    """Find the first marking with a place beyond the capacity.

    Args:
        problem: The nets.
        found: Some of their markings, or all.
        emptied: Whether to look only at places that transitions empty.
    """
    first: tuple[int, int] | None = None
    for place, declared in enumerate(problem.compiled.net.places.values()):
        if declared.capacity is not None and (not emptied or declared.name in problem.composition.emptied):
            over = found.packing.holds(found.words[:, : found.count], place, declared.capacity + 1).nonzero()[0]
            if len(over) and (first is None or over[0] < first[0]):
                first = (int(over[0]), place)
    if first is None:
        return None
    number, place = first
    declared = problem.compiled.net.places[problem.compiled.places[place]]
    tokens = found.vector(number)[place]
    kind = "assumption" if declared.name in problem.composition.promises else "overflow"
    reason = too_many(problem, declared.name, tokens)
    return Counterexample(kind, reason, found.sequence(number), found.marking(number))


def too_many(problem: Problem, name: str, tokens: int) -> str:
    """Describe a place with more tokens than the capacity."""
    promise, capacity = problem.composition.promises.get(name), problem.compiled.net.places[name].capacity
    if promise is not None:
        return promise.format(tokens=tokens)
    return f"place {name} gets {tokens} tokens, more than its capacity of {capacity}"


def deadlock(problem: Problem, sequence: tuple[str, ...], vector: tuple[int, ...]) -> Counterexample:
    """Describe a marking of stuck nets."""
    compiled = problem.compiled
    marking = compiled.marking(vector)
    held = ", ".join(f"{place}={count}" for place, count in marking.items()) or "no token at all"
    waits = any(kind == WAITS and compiled.enabled(vector, t) for t, kind in enumerate(problem.kinds))
    if waits:
        reason = f"it waits for its tape or a caller away from rest with {held}"
        return Counterexample("deadlock", reason, sequence, marking)
    why = _waits_in_vain(problem, vector)
    siphon = () if why else emptied_siphon(compiled, problem.initial, vector)
    if siphon:
        names = ", ".join(siphon[:_NAMED_PLACES])
        more = f" and {len(siphon) - _NAMED_PLACES} more" if len(siphon) > _NAMED_PLACES else ""
        why = f"; siphon {{{names}{more}}} was emptied, and can never be marked again"
    return Counterexample("deadlock", f"it is stuck with {held}{why}", sequence, marking)


def _waits_in_vain(problem: Problem, vector: tuple[int, ...]) -> str:
    """Return a clause on a transition that waits with tokens under way for a place which nothing marks."""
    compiled = problem.compiled
    places = compiled.net.places
    marked = {name for transition in compiled.net.transitions.values() for name in transition.outputs}
    barren = {i for i, name in enumerate(compiled.places) if name not in marked and not places[name].tokens}
    for name, inputs in zip(compiled.transitions, compiled.inputs, strict=True):
        lacking = [compiled.places[place] for place, _ in inputs if place in barren]
        if lacking and any(vector[place] >= weight for place, weight in inputs if place in problem.busy):
            return f"; {problem.names.get(name, name)} waits for {', '.join(lacking)}, which nothing marks"
    return ""


def lost_entries(
    problem: Problem, found: StateSpace, graph: ReachabilityGraph, live: list[bool]
) -> Iterator[Counterexample]:
    """Find commands and services able to become impossible for ever."""
    for name, ways in problem.ways.items():
        if problem.composition.entries.isdisjoint(problem.compiled.transitions[way] for way in ways):
            continue
        if any(found.fired[way] for way in ways) and not lives(graph, live, ways):
            lost = graph.first_without_return(graph.where_one_is_enabled(ways))
            reason = f"after this {name} can never fire again"
            yield Counterexample("lost_command", reason, found.sequence(lost), found.marking(lost))


def lives(graph: ReachabilityGraph, live: list[bool], ways: tuple[int, ...]) -> bool:
    """Return whether a transition can always be enabled again, in one of the ways."""
    return any(live[way] for way in ways) or (len(ways) > 1 and graph.always_reaches(graph.where_one_is_enabled(ways)))


def unpaid_debts(problem: Problem, found: StateSpace, graph: ReachabilityGraph) -> Iterator[Counterexample]:
    """Find tokens sent under the assumption of a return, and possibly never all returned."""
    for name, reason in problem.composition.debts.items():
        place = problem.compiled.places.index(name)
        paid = ~graph.where_marked(place, 1)
        if not graph.always_reaches(paid):
            lost = graph.first_without_return(paid)
            yield Counterexample("assumption", reason, found.sequence(lost), found.marking(lost))


def held_resources(problem: Problem, found: StateSpace, graph: ReachabilityGraph) -> Iterator[Counterexample]:
    """Find marked places of nets without a declared rest, able to lose tokens for ever."""
    declared = {net.name for net in problem.nets if net.rest is not None}
    for place, name in enumerate(problem.compiled.places):
        tokens = problem.initial[place]
        if not tokens or problem.composition.net_of[name] in declared or graph.regains(place, tokens):
            continue
        lost = graph.first_without_return(graph.where_marked(place, tokens))
        count = f"its {tokens} tokens" if tokens > 1 else "its token"
        yield Counterexample(
            "held_resource",
            f"after this place {name} never has {count} back: what it stands for is held for ever",
            found.sequence(lost),
            found.marking(lost),
        )
