"""Replacement of reset arcs: a transition for each possible number of tokens in the emptied places.

Reachability, and whether a place is bounded, are undecidable of nets with reset arcs (C. Dufourd, A. Finkel and
Ph. Schnoebelen, "Reset nets between decidability and undecidability", 1998). Up to a bound they are no more than a
shorthand: one that finds j tokens takes j, and an inhibitor arc sees to it that there are no more. So the bound of each
such place is declared as its capacity, which verification proves, and every method works on arcs that it knows.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import product

from im_pnt.model.net import Place, Transition
from im_pnt_analysis.composition.flat_net import FlatNet


def ways_to_empty(transition: Transition, places: Mapping[str, Place]) -> Iterator[Transition]:
    """Yield a transition in all ways to find the emptied places; unchanged without any.

    Args:
        transition: The transition.
        places: The places by name; those that it empties have a capacity.
    """
    if not transition.resets:
        yield transition
        return
    ranges = [range(transition.inputs.get(name, 0), (places[name].capacity or 0) + 1) for name in transition.resets]
    for found in product(*ranges):
        inputs, inhibitors = dict(transition.inputs), dict(transition.inhibitors)
        for name, tokens in zip(transition.resets, found, strict=True):
            if inhibitors.get(name, tokens + 1) <= tokens:
                break
            inhibitors[name] = tokens + 1
            inputs |= {name: tokens} if tokens else {}
        else:
            shown = ", ".join(f"{name}={tokens}" for name, tokens in zip(transition.resets, found, strict=True))
            yield replace(
                transition, name=f"{transition.name}({shown})", inputs=inputs, inhibitors=inhibitors, resets=()
            )


def stop_above_capacity(flat: FlatNet, emptied: Collection[str]) -> None:
    """Block all firings where an emptied place holds more than the capacity."""
    for name, transition in flat.transitions.items() if emptied else ():
        inhibitors = dict(transition.inhibitors)
        for place in emptied:
            over = (flat.places[place].capacity or 0) + 1
            inhibitors[place] = min(over, inhibitors.get(place, over))
        flat.transitions[name] = replace(transition, inhibitors=inhibitors)
