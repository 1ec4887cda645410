"""Nets for any tool: no inhibitor arcs, no implied phases, nothing in ``toolspecific``.

An inhibitor arc from a place with bound B asks for less than w tokens; its complement place, which always holds the B
tokens that the place lacks, then holds at least B - w + 1 of them (Murata, 1989, section V).
"""

from collections.abc import Mapping

from im_pnt.errors import NetError
from im_pnt.model.compiled import compile_net
from im_pnt.model.net import Net, Place, Transition
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.structure.state_equation import place_bounds


def plain_net(net: Net, deadline: float | None = None) -> tuple[Net, tuple[str, ...]]:
    """Return the net of the analysis, in places, transitions and arcs alone, and the replacements.

    Args:
        net: The net as written; its phases, coordination structures and surroundings become part of it.
        deadline: Time of :func:`im_core.clock.thread_cpu` until which bounds are looked for [s]; None: without end.

    Raises:
        NetError: An inhibitor arc from a place without a known bound.
    """
    flat = compose([net]).net
    compiled = compile_net(flat)
    inhibiting = dict.fromkeys(name for t in flat.transitions.values() for name in t.inhibitors)
    found: Mapping[str, int | None] = {}
    if inhibiting:
        found = place_bounds(compiled, compiled.marking_vector(flat.initial_marking()), deadline)
    bounds: dict[str, int] = {}
    said: list[str] = []
    for name in inhibiting:
        bound, source = found.get(name), "which no marking exceeds"
        if bound is None:
            bound, source = flat.places[name].capacity, "its capacity (where it would be exceeded, this net waits)"
        if bound is None:
            users = [t.name for t in flat.transitions.values() if name in t.inhibitors]
            raise NetError(
                f"net {net.name} cannot be written without inhibitor arcs: no bound is known of place {name}, which "
                f"inhibits {', '.join(users)}; give it a capacity",
                net=net.name,
                place=name,
            )
        bounds[name] = bound
        complement = _complement(flat, name)
        said.append(f"inhibitor arcs from {name} become arcs to its complement {complement}: bound {bound}, {source}")
    places = {name: Place(name, place.tokens, title=place.title) for name, place in flat.places.items()}
    for name, bound in bounds.items():
        complement = _complement(flat, name)
        places[complement] = Place(complement, max(0, bound - flat.places[name].tokens))
    transitions = {name: _plain(flat, transition, bounds) for name, transition in flat.transitions.items()}
    return Net(net.name, places, transitions, description=net.description, source=net.source), tuple(said)


def _plain(net: Net, transition: Transition, bounds: Mapping[str, int]) -> Transition:
    inputs, outputs = dict(transition.inputs), dict(transition.outputs)
    for place, bound in bounds.items():
        gain = transition.outputs.get(place, 0) - transition.inputs.get(place, 0)
        least = bound - transition.inhibitors[place] + 1 if place in transition.inhibitors else 0
        taken = max(gain, least, 0)
        complement = _complement(net, place)
        if taken:
            inputs[complement] = taken
        if taken - gain:
            outputs[complement] = taken - gain
    return Transition(transition.name, inputs, outputs, origin=transition.name, title=transition.title)


def _complement(net: Net, place: str) -> str:
    name = f"not_{place}"
    while name in net.places or name in net.transitions:
        name = f"{name}_"
    return name
