"""Bounds of places from the state equation: what no firing sequence at all can exceed.

A weighting y >= 0 of the places that no firing raises (y C <= 0) bounds a place p by y m0 / y_p (Murata, 1989).
"""

from collections.abc import Mapping, Sequence

from im_core.clock import monotonic
from im_pnt.analysis.cone import firing_counts, weightings
from im_pnt.compiled import Compiled


def place_bounds(compiled: Compiled, initial: Sequence[int], deadline: float | None = None) -> Mapping[str, int | None]:
    """Returns an upper bound of the tokens of each place; None: none was found.

    Args:
        compiled: The net; inhibitor arcs are left out, which keeps the bounds true.
        initial: Initial marking, tokens of each place.
        deadline: Time of :func:`im_core.clock.monotonic` at which to give up [s]; None: never.
    """
    bounds: dict[str, int | None] = dict.fromkeys(compiled.places)
    cone = weightings(compiled)
    for place in range(len(compiled.places)):
        if deadline is not None and monotonic() > deadline:
            break
        weights = cone.cheapest(initial, [place], deadline=deadline)
        total = sum(weight * initial[other] for other, weight in weights.items())
        for other, weight in weights.items():
            name = compiled.places[other]
            bound = bounds[name]
            bounds[name] = total // weight if bound is None else min(bound, total // weight)
    return bounds


def structurally_bounded(compiled: Compiled, deadline: float | None = None) -> bool | None:
    """Whether every place is bounded whatever the initial marking; None: not decided.

    Args:
        compiled: The net; with inhibitor arcs the answer False is about the net without them.
        deadline: Time of :func:`im_core.clock.monotonic` at which to give up [s]; None: never.
    """
    everywhere = range(len(compiled.places))
    if not compiled.places or weightings(compiled).cheapest([1] * len(everywhere), everywhere, deadline=deadline):
        return True
    costs = [1] * len(compiled.transitions)
    return False if firing_counts(compiled).cheapest(costs, slack=True, deadline=deadline) else None
