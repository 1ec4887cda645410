"""Sets of places that are closed under the arcs of a net: siphons, and traps with the arcs turned round."""

from collections.abc import Callable, Iterable, Sequence

from im_pnt.compiled import Compiled, IndexedArcs


class ClosedSets:
    """The sets in which, if a transition gives to a place of the set, it also takes from one.

    Attributes:
        pairs: For each transition the places it takes from and those it gives to.

    Args:
        takes: For each transition the arcs by which it takes.
        gives: For each transition the arcs by which it gives.
    """

    def __init__(self, takes: Sequence[IndexedArcs], gives: Sequence[IndexedArcs]) -> None:
        self.pairs = [
            (frozenset(place for place, _ in needed), frozenset(place for place, _ in given))
            for needed, given in zip(takes, gives, strict=True)
        ]
        self._taking: dict[int, list[int]] = {}
        for transition, (needed, _) in enumerate(self.pairs):
            for place in needed:
                self._taking.setdefault(place, []).append(transition)

    def largest(self, places: Iterable[int]) -> frozenset[int]:
        """Returns the largest closed set within some places; it may be empty."""
        left = set(places)
        self._drop(left, [given for needed, given in self.pairs if left.isdisjoint(needed)])
        return frozenset(left)

    def minimal(self, places: frozenset[int], keep: Callable[[frozenset[int]], bool] = bool) -> frozenset[int]:
        """Shrinks a closed set to one of which no part is closed.

        Args:
            places: The closed set.
            keep: Property that it has and must not lose; by default that it is not empty.
        """
        for place in sorted(places):
            if place in places:
                left = set(places)
                self._drop(left, [frozenset((place,))])
                if keep(smaller := frozenset(left)):
                    places = smaller
        return places

    def _drop(self, left: set[int], groups: list[frozenset[int]]) -> None:
        """Takes places out of a set, and with them all that cannot stay without them."""
        while groups:
            for place in groups.pop() & left:
                left.discard(place)
                for transition in self._taking.get(place, ()):
                    needed, given = self.pairs[transition]
                    if left.isdisjoint(needed):
                        groups.append(given)


def siphon_sets(compiled: Compiled) -> ClosedSets:
    """Returns the siphons of a net: whoever gives to one of the places takes from one."""
    return ClosedSets(compiled.inputs, compiled.outputs)


def trap_sets(compiled: Compiled) -> ClosedSets:
    """Returns the traps of a net: whoever takes from one of the places gives to one."""
    return ClosedSets(compiled.outputs, compiled.inputs)


def names(compiled: Compiled, places: Iterable[int]) -> tuple[str, ...]:
    """Returns the names of some places, in the order of the net."""
    return tuple(compiled.places[place] for place in sorted(places))


def unmarked_siphon(compiled: Compiled, marking: tuple[int, ...]) -> tuple[str, ...]:
    """Returns a minimal siphon that is empty in a marking, and so for ever after; empty: there is none.

    In a dead marking of a net with input weights of 1 it names what is missing.

    Args:
        compiled: The net.
        marking: Tokens of each place.
    """
    sets = siphon_sets(compiled)
    return names(compiled, sets.minimal(sets.largest(_unmarked(marking))))


def emptied_siphon(compiled: Compiled, initial: tuple[int, ...], marking: tuple[int, ...]) -> tuple[str, ...]:
    """Returns a smallest possible siphon that was marked at first and is empty now; empty: there is none.

    Args:
        compiled: The net.
        initial: Initial marking, tokens of each place.
        marking: Tokens of each place now.
    """
    sets = siphon_sets(compiled)
    empty = sets.largest(_unmarked(marking))
    if not any(initial[place] for place in empty):
        return ()
    return names(compiled, sets.minimal(empty, keep=lambda part: any(initial[place] for place in part)))


def _unmarked(marking: tuple[int, ...]) -> list[int]:
    return [place for place, tokens in enumerate(marking) if not tokens]
