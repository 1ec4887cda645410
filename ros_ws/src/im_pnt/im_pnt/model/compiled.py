"""Net as arrays, for execution and analysis."""

from collections.abc import Sequence
from dataclasses import dataclass

from im_core.errors import nearest
from im_pnt.errors import NetError
from im_pnt.model.net import Arcs, Marking, Net

IndexedArcs = tuple[tuple[int, int], ...]
"""Pairs of place index and weight."""


@dataclass(frozen=True, slots=True)
class Compiled:
    """A net in indices; places and transitions keep the order of the net.

    Attributes:
        net: The net.
        places: Place names.
        transitions: Transition names.
        inputs: For each transition its input arcs.
        outputs: For each transition its output arcs.
        inhibitors: For each transition its inhibitor arcs; it is disabled at that many tokens or more.
        resets: For each transition the places that it empties when it has taken its tokens.
        change: For each transition the net change of each place it changes (a column of the incidence matrix), but for
            what its resets take: that depends on the marking.
        consumers: For each place the transitions that take from it, with weight.
        inhibited: For each place the transitions that it inhibits, with weight.
    """

    net: Net
    places: tuple[str, ...]
    transitions: tuple[str, ...]
    inputs: tuple[IndexedArcs, ...]
    outputs: tuple[IndexedArcs, ...]
    inhibitors: tuple[IndexedArcs, ...]
    resets: tuple[tuple[int, ...], ...]
    change: tuple[IndexedArcs, ...]
    consumers: tuple[IndexedArcs, ...]
    inhibited: tuple[IndexedArcs, ...]

    def marking_vector(self, marking: Marking) -> tuple[int, ...]:
        """Return the tokens of each place in order.

        Raises:
            NetError: The marking names a place that the net does not have.
        """
        for name in marking:
            if name not in self.net.places:
                raise NetError(f"net {self.net.name} has no place {name}{nearest(name, self.places)}", place=name)
        return tuple(marking.get(name, 0) for name in self.places)

    def marking(self, vector: tuple[int, ...]) -> dict[str, int]:
        """Return the marked places by name."""
        return {name: count for name, count in zip(self.places, vector, strict=True) if count}

    def enabled(self, vector: Sequence[int], transition: int) -> bool:
        """Return whether a transition may fire by the arcs alone, without guards and symbols."""
        return all(vector[place] >= weight for place, weight in self.inputs[transition]) and all(
            vector[place] < weight for place, weight in self.inhibitors[transition]
        )

    def degree(self, vector: Sequence[int], transition: int) -> int:
        """Return how often an enabled transition with inputs could fire one time after the other, and no other one."""
        return min(vector[place] // weight for place, weight in self.inputs[transition])

    def fire(self, vector: tuple[int, ...], transition: int) -> tuple[int, ...]:
        """Return the marking after the firing of an enabled transition."""
        after = list(vector)
        for place, change in self.change[transition]:
            after[place] += change
        if self.resets[transition]:
            given = dict(self.outputs[transition])
            for place in self.resets[transition]:
                after[place] = given.get(place, 0)
        return tuple(after)


def compile_net(net: Net) -> Compiled:
    """Number the places and transitions of a net.

    Args:
        net: The net; expand it first where the phases matter.
    """
    number = {name: index for index, name in enumerate(net.places)}
    transitions = list(net.transitions.values())

    def indexed(arcs: Arcs) -> IndexedArcs:
        return tuple((number[name], weight) for name, weight in arcs.items())

    inputs = [indexed(t.inputs) for t in transitions]
    outputs = [indexed(t.outputs) for t in transitions]
    inhibitors = [indexed(t.inhibitors) for t in transitions]
    return Compiled(
        net,
        tuple(net.places),
        tuple(net.transitions),
        tuple(inputs),
        tuple(outputs),
        tuple(inhibitors),
        tuple(tuple(number[name] for name in t.resets) for t in transitions),
        tuple(_change(taken, given) for taken, given in zip(inputs, outputs, strict=True)),
        _by_place(inputs, len(number)),
        _by_place(inhibitors, len(number)),
    )


def _change(taken: IndexedArcs, given: IndexedArcs) -> IndexedArcs:
    total: dict[int, int] = {}
    for place, weight in given:
        total[place] = total.get(place, 0) + weight
    for place, weight in taken:
        total[place] = total.get(place, 0) - weight
    return tuple((place, change) for place, change in total.items() if change)


def _by_place(arcs: list[IndexedArcs], n_places: int) -> tuple[IndexedArcs, ...]:
    rows: list[list[tuple[int, int]]] = [[] for _ in range(n_places)]
    for transition, pairs in enumerate(arcs):
        for place, weight in pairs:
            rows[place].append((transition, weight))
    return tuple(tuple(row) for row in rows)
