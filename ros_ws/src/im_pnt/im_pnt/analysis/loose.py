"""A net whose places and transitions can be taken away and joined; those that stay keep their numbers."""

from collections.abc import Iterator

from im_pnt.compiled import Compiled

Arcs = dict[int, int]
"""Place to weight."""


class LooseNet:
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

    Args:
        compiled: The original net.
        initial: Initial marking, tokens of each place.
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
        """Adds a transition."""
        number = self._next
        self._next += 1
        self.inputs[number], self.outputs[number], self.parts[number] = inputs, outputs, parts
        for place in inputs:
            self.takers[place].add(number)
        for place in outputs:
            self.givers[place].add(number)

    def remove_transition(self, transition: int) -> None:
        """Takes a transition away."""
        for place in self.inputs.pop(transition):
            self.takers[place].discard(transition)
        for place in self.outputs.pop(transition):
            self.givers[place].discard(transition)
        self.inhibitors.pop(transition, None)
        del self.parts[transition]

    def remove_place(self, place: int) -> None:
        """Takes a place and its arcs away."""
        for transition in self.takers.pop(place):
            del self.inputs[transition][place]
        for transition in self.givers.pop(place):
            del self.outputs[transition][place]
        del self.tokens[place]

    def change(self, transition: int, place: int) -> int:
        """Returns how many tokens a firing adds to a place."""
        return self.outputs[transition].get(place, 0) - self.inputs[transition].get(place, 0)

    def join(self, place: int) -> None:
        """Replaces a place by joining each transition that gives it one token to each that takes that token."""
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
        """Whether no inhibitor arc is at a transition or at a place that it touches."""
        return transition not in self.inhibitors and self.tested.isdisjoint(
            self.inputs[transition].keys() | self.outputs[transition].keys()
        )

    def places(self) -> Iterator[int]:
        """Yields the places without inhibitor arcs that are left; they may be taken away meanwhile."""
        for place in list(self.tokens):
            if place in self.tokens and place not in self.tested:
                yield place

    def transitions(self) -> Iterator[int]:
        """Yields the transitions that are left; they may be taken away meanwhile."""
        for transition in list(self.inputs):
            if transition in self.inputs:
                yield transition


def _sum(a: Arcs, b: Arcs, without: int) -> Arcs:
    total = dict(a)
    for place, weight in b.items():
        total[place] = total.get(place, 0) + weight
    total.pop(without, None)
    return total
