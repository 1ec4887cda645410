"""Precedence of transitions, written out in arcs: immediate before timed, and priority among those that contend.

A transition with a delay waits until nothing without one is enabled; of two that share an input place the one of lower
priority waits. So a transition fires where each that goes before it lacks a token or is inhibited. That is a condition
of inhibitor arcs and of arcs back and forth; a transition with several input places lacks one of them, which makes
several ways to fire.

What goes before must be told by the marking alone: no guard, no symbol, and tokens of one command at most. In a net
that something else moves too, an action, a symbol or another net, only what contends for a token is put in order.
"""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from im_pnt.model.net import Net, Role, Transition
from im_pnt.model.resources import resource_places
from im_pnt_analysis.composition.compose import Composition
from im_pnt_analysis.composition.flat_net import NOT_LOOKED_AT

MOST_WAYS = 256
"""Ways of a transition at which its precedence is left out."""


class _Condition(NamedTuple):
    """Condition of enabling: at least a number of tokens in a place, or fewer."""

    place: str
    tokens: int
    enough: bool


@dataclass(frozen=True, slots=True)
class Precedence:
    """Composition in which lower transitions wait for higher ones.

    Attributes:
        composition: The composition.
        names: For each transition that is one way to fire another the name of that.
    """

    composition: Composition
    names: Mapping[str, str]


def with_precedence(composition: Composition, nets: Sequence[Net]) -> Precedence:
    """Write out the precedence of transitions."""
    net, closed = composition.net, _is_closed(composition)
    resources = {f"{each.name}." * (len(nets) > 1) + place for each in nets for place in resource_places(each)}
    transitions: dict[str, Transition] = {}
    names: dict[str, str] = {}
    left_out: dict[str, None] = {}
    ordered = False
    order = _PriorityOrder(net, closed)
    for transition in net.transitions.values():
        before = order.before(transition)
        unsure = [] if closed else [other.name for other in before if not _is_of_one(other, net, resources)]
        left_out.update(dict.fromkeys(unsure))
        before = [other for other in before if other.name not in unsure]
        ways = _ways(transition, before)
        if ways is None or (len(ways) > 1 and transition.name in composition.external | composition.entries):
            left_out[transition.name] = None
            ways = [transition]
        ordered = ordered or ways != [transition]
        for number, way in enumerate(ways, start=1):
            name = transition.name if len(ways) == 1 else f"{transition.name}({number})"
            transitions[name] = replace(way, name=name)
            if name != transition.name:
                names[name] = transition.name
    said = []
    if ordered:
        counts = "immediate before timed" if closed else "of those that contend for a token"
        said.append(f"delays and priorities ({net.name}) count: {counts}, and nobody pauses or steps the net by hand")
    if left_out:
        why = "it takes tokens of several commands, or has too many ways to fire"
        said.append(f"{NOT_LOOKED_AT}what goes before what at {', '.join(left_out)}: {why}")
    changed = replace(
        composition,
        net=replace(net, transitions=transitions),
        ways={**composition.ways, **{name: composition.ways.get(meant, meant) for name, meant in names.items()}},
        assumptions=(*composition.assumptions, *said),
    )
    return Precedence(changed, names)


def _is_closed(composition: Composition) -> bool:
    """Return whether the marking alone tells what fires first, in a net in which something does.

    Two clocks of constant times may strike together, and what the first one enables comes after the second.
    """
    transitions = composition.net.transitions.values()
    plain = all(t.role is Role.PLAIN and not (t.action or t.symbol or t.guard or t.remote_outputs) for t in transitions)
    constant = [t for t in transitions if t.delay is not None and t.delay.kind == "constant"]
    ranks = {(t.delay is None, t.priority if t.delay is None else 0) for t in transitions}
    single = len(set(composition.net_of.values())) <= 1
    clocks = sum(min(t.at_once, 2) for t in constant)
    return plain and single and clocks <= 1 and len(ranks) > 1 and not composition.external


_FIRING = (Role.PLAIN, Role.START)


class _PriorityOrder:
    """Order in which transitions of a net may fire.

    Args:
        net: The composition.
        closed: Whether a timed one waits for all that need no time.
    """

    def __init__(self, net: Net, closed: bool) -> None:
        self._closed = closed
        untimed = (t for t in net.transitions.values() if t.role in _FIRING and not _is_timed(t))
        self._all = [t for t in untimed if not (t.guard or t.symbol) and (t.inputs or t.inhibitors)]
        self._most = max((t.priority for t in net.transitions.values()), default=0)
        self._rank = {t.name: rank for rank, t in enumerate(self._all)}
        self._taking: dict[str, list[Transition]] = {}
        for each in self._all:
            for place in each.inputs:
                self._taking.setdefault(place, []).append(each)

    def before(self, transition: Transition) -> list[Transition]:
        """Return the transitions that go before one where they are enabled; without those that nothing holds back."""
        timed = _is_timed(transition)
        if transition.role not in _FIRING or not (timed or transition.priority < self._most):
            return []
        if timed and self._closed:
            return self._all
        contending = {t.name: t for place in transition.inputs for t in self._taking.get(place, ())}.values()
        first = (other for other in contending if timed or other.priority > transition.priority)
        return sorted(first, key=lambda other: self._rank[other.name])


def _is_timed(transition: Transition) -> bool:
    return transition.delay is not None and transition.action is None


def _is_of_one(transition: Transition, net: Net, resources: Container[str]) -> bool:
    """Return whether a transition takes at most one token that may belong to a command."""
    owned = (n for place, n in transition.inputs.items() if place not in resources and not net.places[place].resource)
    return sum(owned) <= 1


def _ways(transition: Transition, before: Sequence[Transition]) -> list[Transition] | None:
    """Return a transition in all ways to fire while others are not enabled; None where there are too many."""
    ways = [transition]
    for other in before:
        inputs = [_Condition(place, weight, True) for place, weight in other.inputs.items()]
        conditions = [*inputs, *(_Condition(place, weight, False) for place, weight in other.inhibitors.items())]
        found = []
        for way in ways:
            left: Transition | None = way
            for condition in conditions:  # disjoint: this one is the first that fails
                if left is None:
                    break
                failing = _with(left, condition._replace(enough=not condition.enough))
                found += [failing] if failing is not None else []
                left = _with(left, condition)
        ways = found
        if len(ways) > MOST_WAYS:
            return None
    if not ways:  # it never fires, which the verdict says of its name
        place = next(iter(transition.inputs))
        ways = [replace(transition, inhibitors={**transition.inhibitors, place: 1})]
    return ways


def _with(transition: Transition, condition: _Condition) -> Transition | None:
    """Return a transition that needs a condition, too; None if it could never fire."""
    place, tokens, enough = condition
    taken, below = transition.inputs.get(place, 0), transition.inhibitors.get(place)
    if not enough:
        below = tokens if below is None else min(below, tokens)
        return replace(transition, inhibitors={**transition.inhibitors, place: below}) if taken < below else None
    more = max(0, tokens - taken)
    if below is not None and taken + more >= below:
        return None
    if not more:
        return transition
    back = transition.outputs.get(place, 0) + more
    return replace(
        transition, inputs={**transition.inputs, place: taken + more}, outputs={**transition.outputs, place: back}
    )
