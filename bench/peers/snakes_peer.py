"""SNAKES: black tokens. Each step lists the modes of all transitions, as its own simulator does, and fires the first.

With ``--in-turn`` the transitions are tried one after the other, and the first mode of an enabled one is fired: less
work a firing than any fair choice needs.
"""

import sys

from serve import serve
from snakes.nets import PetriNet, Place, Transition, Value, dot


def load(net):
    """Builds a net."""
    model = PetriNet("net")
    for name, tokens in net["places"].items():
        model.add_place(Place(name, [dot] * tokens))
    for name, (inputs, outputs) in net["transitions"].items():
        model.add_transition(Transition(name))
        for place in inputs:
            model.add_input(place, name, Value(dot))
        for place in outputs:
            model.add_output(place, name, Value(dot))
    return _in_turn(model) if "--in-turn" in sys.argv[1:] else _first_of_all(model)


def _first_of_all(model):
    transitions = model.transition()

    def fire(firings):
        for _ in range(firings):
            modes = [(transition, mode) for transition in transitions for mode in transition.modes()]
            transition, mode = modes[0]
            transition.fire(mode)
        return firings

    return fire


def _in_turn(model):
    transitions = model.transition()
    at = [0]

    def fire(firings):
        fired = 0
        while fired < firings:
            transition = transitions[at[0]]
            at[0] = (at[0] + 1) % len(transitions)
            modes = transition.modes()
            if modes:
                transition.fire(modes[0])
                fired += 1
        return fired

    return fire


if __name__ == "__main__":
    serve(load)
