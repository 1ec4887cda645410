"""Tokens counted in the steps in which firings change them, so that large weights need no large numbers."""

from collections.abc import Sequence
from math import gcd

from im_pnt.compiled import Compiled, IndexedArcs


class Units:
    """A net in units: a place holds ``rest + step * units`` tokens.

    Args:
        compiled: The net.
        initial: Tokens of each place in the first marking.

    Attributes:
        names: Names of the places.
        step: For each place the greatest common divisor of what firings change.
        rest: For each place the tokens that never leave it, fewer than a step.
        inputs: For each transition its input arcs in units, those left out that are always met.
        inhibitors: For each transition its inhibitor arcs in units; 0: it is always inhibited.
        change: For each transition its effect in units.
    """

    def __init__(self, compiled: Compiled, initial: Sequence[int]) -> None:
        self.names = compiled.places
        self.step = [0] * len(initial)
        for change in compiled.change:
            for place, delta in change:
                self.step[place] = gcd(self.step[place], delta)
        self.step = [step or max(1, count) for step, count in zip(self.step, initial, strict=True)]
        self.rest = [count % step for count, step in zip(initial, self.step, strict=True)]
        self.inputs = tuple(
            tuple((place, units) for place, units in self._needed(arcs) if units) for arcs in compiled.inputs
        )
        self.inhibitors = tuple(self._needed(arcs) for arcs in compiled.inhibitors)
        self.change = tuple(
            tuple((place, delta // self.step[place]) for place, delta in change) for change in compiled.change
        )

    def of(self, place: int, tokens: int) -> int:
        """Returns the units of a place that holds so many tokens."""
        return (tokens - self.rest[place]) // self.step[place]

    def tokens(self, place: int, units: int) -> int:
        """Returns the tokens of a place that holds so many units."""
        return self.rest[place] + self.step[place] * units

    def needed(self, place: int, tokens: int) -> int:
        """Returns the least units with which a place holds at least so many tokens."""
        return max(0, -((self.rest[place] - tokens) // self.step[place]))

    def _needed(self, arcs: IndexedArcs) -> IndexedArcs:
        return tuple((place, self.needed(place, weight)) for place, weight in arcs)

    def bounds(self, tokens: Sequence[int | None]) -> list[int | None]:
        """Returns bounds on tokens as bounds on units."""
        return [None if bound is None else self.of(place, bound) for place, bound in enumerate(tokens)]

    def widths(self, initial: Sequence[int]) -> list[int]:
        """Returns for each place the bits that its first units and every arc weight need."""
        largest = [max(1, self.of(place, count)) for place, count in enumerate(initial)]
        for arcs in (*self.inputs, *self.inhibitors, *self.change):
            for place, units in arcs:
                largest[place] = max(largest[place], abs(units))
        return [units.bit_length() for units in largest]
