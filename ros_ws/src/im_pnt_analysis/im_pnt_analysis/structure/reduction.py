"""Structural reductions under which deadlocks are preserved (Berthelot, 1986; Murata, 1989, section V).

A firing sequence of the reduced net to a dead marking is expanded to one of the original net. Boundedness and liveness
are not kept. Nodes at inhibitor arcs are left as they are.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.net import Net, Place, Transition

Arcs = dict[int, int]
"""Place to weight."""


class NetReduction:
    """A net being reduced.

    Attributes:
        tokens: Initial marking of each place that is left.
        inputs: Input arcs of each transition that is left.
        outputs: Output arcs of each transition that is left.
        takers: For each place the transitions that take from it.
        givers: For each place the transitions that give to it.
        inhibitors: Inhibitor arcs of the transitions that have some.
        tested: Places at inhibitor arcs.
        parts: For each transition those of the original net that it stands for, in the order of firing.
    """

    def __init__(self, compiled: Compiled, initial: tuple[int, ...]) -> None:
        self.tokens = dict(enumerate(initial))
        self.inputs: dict[int, Arcs] = {}
        self.outputs: dict[int, Arcs] = {}
        self.takers: dict[int, set[int]] = {place: set() for place in self.tokens}
        self.givers: dict[int, set[int]] = {place: set() for place in self.tokens}
        self.inhibitors = {number: dict(arcs) for number, arcs in enumerate(compiled.inhibitors) if arcs}
        self.tested = {place for arcs in self.inhibitors.values() for place in arcs}
        self.parts: dict[int, tuple[int, ...]] = {}
        self._next = 0
        for number in range(len(compiled.transitions)):
            self.add_transition(dict(compiled.inputs[number]), dict(compiled.outputs[number]), (number,))

    def add_transition(self, inputs: Arcs, outputs: Arcs, parts: tuple[int, ...]) -> None:
        """Add a transition."""
        number = self._next
        self._next += 1
        self.inputs[number], self.outputs[number], self.parts[number] = inputs, outputs, parts
        for place in inputs:
            self.takers[place].add(number)
        for place in outputs:
            self.givers[place].add(number)

    def remove_transition(self, transition: int) -> None:
        """Remove a transition."""
        for place in self.inputs.pop(transition):
            self.takers[place].discard(transition)
        for place in self.outputs.pop(transition):
            self.givers[place].discard(transition)
        self.inhibitors.pop(transition, None)
        del self.parts[transition]

    def remove_place(self, place: int) -> None:
        """Remove a place and the arcs."""
        for transition in self.takers.pop(place):
            del self.inputs[transition][place]
        for transition in self.givers.pop(place):
            del self.outputs[transition][place]
        del self.tokens[place]

    def change(self, transition: int, place: int) -> int:
        """Return the number of tokens added to a place by a firing."""
        return self.outputs[transition].get(place, 0) - self.inputs[transition].get(place, 0)

    def join(self, place: int) -> None:
        """Replace a place: join each transition giving one token to each transition taking one."""
        givers, takers = sorted(self.givers[place]), sorted(self.takers[place])
        for first in givers:
            for second in takers:
                inputs = _sum(self.inputs[first], self.inputs[second], place)
                outputs = _sum(self.outputs[first], self.outputs[second], place)
                self.add_transition(inputs, outputs, self.parts[first] + self.parts[second])
        for transition in givers + takers:
            self.remove_transition(transition)
        self.remove_place(place)

    def free(self, transition: int) -> bool:
        """Return whether no inhibitor arc is at a transition or the places."""
        return transition not in self.inhibitors and self.tested.isdisjoint(
            self.inputs[transition].keys() | self.outputs[transition].keys()
        )

    def places(self) -> Iterator[int]:
        """Yield the remaining places without inhibitor arcs; a place may be removed meanwhile."""
        for place in list(self.tokens):
            if place in self.tokens and place not in self.tested:
                yield place

    def transitions(self) -> Iterator[int]:
        """Yield the remaining transitions; a transition may be removed meanwhile."""
        for transition in list(self.inputs):
            if transition in self.inputs:
                yield transition


def _sum(a: Arcs, b: Arcs, without: int) -> Arcs:
    total = dict(a)
    for place, weight in b.items():
        total[place] = total.get(place, 0) + weight
    total.pop(without, None)
    return total


_MOST_PARTS = 1_000


@dataclass(frozen=True, slots=True)
class ReducedNet:
    """Smaller net with a deadlock if and only if the original one has one.

    Attributes:
        original_initial: Its initial marking.
        initial: Its initial marking.
        parts: For each transition those of the original net that fire in its place.
        delayed: Sequences of transitions of the original net that the reduced one puts off; before a marking counts as
            dead they fire as often as they can, in this order.
    """

    original: Compiled
    original_initial: tuple[int, ...]
    compiled: Compiled
    initial: tuple[int, ...]
    parts: tuple[tuple[int, ...], ...]
    delayed: tuple[tuple[int, ...], ...]

    def expand(self, sequence: Sequence[str]) -> tuple[str, ...]:
        """Return the firing sequence of the original net to a dead marking for one of the reduced net."""
        number = {name: index for index, name in enumerate(self.compiled.transitions)}
        steps = [part for name in sequence for part in self.parts[number[name]]]
        marking = self.original_initial
        for step in steps:
            marking = self.original.fire(marking, step)
        for parts in self.delayed:
            while (after := self._fired(marking, parts)) is not None:
                steps.extend(parts)
                marking = after
        return tuple(self.original.transitions[step] for step in steps)

    def _fired(self, marking: tuple[int, ...], steps: tuple[int, ...]) -> tuple[int, ...] | None:
        for step in steps:
            if not self.original.enabled(marking, step):
                return None
            marking = self.original.fire(marking, step)
        return marking


def reduce_for_deadlock(compiled: Compiled, initial: tuple[int, ...], deadline: float | None = None) -> ReducedNet:
    """Reduce a net by all rules.

    Args:
        compiled: The net.
        initial: Initial marking, tokens of each place.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to stop, with what is reduced by then [s].
    """
    net = NetReduction(compiled, initial)
    delayed: list[tuple[int, ...]] = []
    rules = (_dead_transitions, _redundant_places, _redundant_transitions, _post_agglomeration)
    changed = True
    while changed and (deadline is None or thread_cpu() < deadline):
        changed = False
        for rule in rules:
            changed = rule(net) or changed
        changed = _pre_agglomeration(net, delayed) or changed
    return _reduced(net, delayed, compiled, initial)


def _dead_transitions(net: NetReduction) -> bool:
    """Remove transitions with an unmet need of a place without a raising transition."""
    changed = False
    for place in list(net.tokens):
        if all(net.change(transition, place) <= 0 for transition in net.givers[place]):
            for transition in list(net.takers[place]):
                if net.inputs[transition][place] > net.tokens[place]:
                    net.remove_transition(transition)
                    changed = True
    return changed


def _redundant_places(net: NetReduction) -> bool:
    """Remove places never keeping a transition from firing."""
    changed = False
    kept: dict[frozenset[tuple[int, int, int]], int] = {}
    for place in net.places():
        around = net.takers[place] | net.givers[place]
        need = max((net.inputs[transition][place] for transition in net.takers[place]), default=0)
        never_lowered = all(net.change(transition, place) >= 0 for transition in around)
        arcs = frozenset((t, net.inputs[t].get(place, 0), net.outputs[t].get(place, 0)) for t in around)
        twin = kept.get(arcs)
        if never_lowered and net.tokens[place] >= need:
            net.remove_place(place)
        elif twin is not None:
            more = max(place, twin, key=lambda p: net.tokens[p])
            kept[arcs] = twin if more == place else place
            net.remove_place(more)
        else:
            kept[arcs] = place
            continue
        changed = True
    return changed


def _redundant_transitions(net: NetReduction) -> bool:
    """Remove duplicates, and transitions without an effect and always enabled together with another one."""
    changed = False
    kept: set[tuple[frozenset[tuple[int, int]], frozenset[tuple[int, int]]]] = set()
    for transition in net.transitions():
        if transition in net.inhibitors:
            continue
        inputs, outputs = net.inputs[transition], net.outputs[transition]
        arcs = frozenset(inputs.items()), frozenset(outputs.items())
        if arcs in kept or (inputs == outputs and _has_weaker(net, transition)):
            net.remove_transition(transition)
            changed = True
        else:
            kept.add(arcs)
    return changed


def _has_weaker(net: NetReduction, transition: int) -> bool:
    inputs = net.inputs[transition]
    others = {other for place in inputs for other in net.takers[place]} - {transition}
    return any(
        other not in net.inhibitors and all(inputs.get(place, 0) >= w for place, w in net.inputs[other].items())
        for other in others
    )


def _post_agglomeration(net: NetReduction) -> bool:
    """Join the givers of a place to the takers with no other input: such takers can fire at once."""
    changed = False
    for place in net.places():
        if (
            _between(net, place)
            and all(len(net.inputs[taker]) == 1 and net.free(taker) for taker in net.takers[place])
            and not any(giver in net.inhibitors for giver in net.givers[place])
        ):
            net.join(place)
            changed = True
    return changed


def _pre_agglomeration(net: NetReduction, delayed: list[tuple[int, ...]]) -> bool:
    """Join the takers of a place to the only giver without other effects: such a giver can wait for the takers."""
    changed = False
    for place in net.places():
        if not _between(net, place) or len(net.givers[place]) != 1:
            continue
        (giver,) = net.givers[place]
        if (
            len(net.outputs[giver]) == 1
            and net.inputs[giver]
            and net.free(giver)
            and all(net.takers[other] == {giver} for other in net.inputs[giver])
            and not any(taker in net.inhibitors for taker in net.takers[place])
        ):
            delayed.append(net.parts[giver])
            net.join(place)
            changed = True
    return changed


def _between(net: NetReduction, place: int) -> bool:
    """Whether a place is empty at first, single tokens go in and out, and joining does not add many transitions."""
    givers, takers = net.givers[place], net.takers[place]
    return (
        net.tokens[place] == 0
        and bool(givers and takers)
        and givers.isdisjoint(takers)
        and len(givers) * len(takers) <= len(givers) + len(takers)
        and all(net.outputs[giver][place] == 1 for giver in givers)
        and all(net.inputs[taker][place] == 1 for taker in takers)
        and max(len(net.parts[t]) for t in givers) + max(len(net.parts[t]) for t in takers) <= _MOST_PARTS
    )


def _reduced(
    net: NetReduction, delayed: list[tuple[int, ...]], original: Compiled, initial: tuple[int, ...]
) -> ReducedNet:
    names = original.places
    transitions = {}
    for number, inputs in net.inputs.items():
        name = str(number)
        arcs = [inputs, net.outputs[number], net.inhibitors.get(number, {})]
        taken, given, inhibiting = ({names[place]: weight for place, weight in part.items()} for part in arcs)
        transitions[name] = Transition(name, taken, given, inhibitors=inhibiting, origin=name)
    places = {names[place]: Place(names[place], tokens) for place, tokens in net.tokens.items()}
    return ReducedNet(
        original,
        initial,
        compile_net(Net(original.net.name, places, transitions)),
        tuple(net.tokens.values()),
        tuple(net.parts.values()),
        tuple(reversed(delayed)),
    )
