"""pm4py: the enabled transitions of a marking, then the marking that one of them makes, as its semantics offers it."""

from pm4py.objects.petri_net.obj import Marking, PetriNet
from pm4py.objects.petri_net.semantics import ClassicSemantics
from pm4py.objects.petri_net.utils import petri_utils
from serve import serve


def load(net):
    """Builds a net."""
    model = PetriNet("net")
    places = {name: PetriNet.Place(name) for name in net["places"]}
    model.places.update(places.values())
    for name, (inputs, outputs) in net["transitions"].items():
        transition = PetriNet.Transition(name, name)
        model.transitions.add(transition)
        for place in inputs:
            petri_utils.add_arc_from_to(places[place], transition, model)
        for place in outputs:
            petri_utils.add_arc_from_to(transition, places[place], model)
    marking = [Marking({places[name]: tokens for name, tokens in net["places"].items() if tokens})]
    semantics = ClassicSemantics()

    def fire(firings):
        for _ in range(firings):
            enabled = semantics.enabled_transitions(model, marking[0])
            marking[0] = semantics.execute(next(iter(enabled)), model, marking[0])
        return firings

    return fire


if __name__ == "__main__":
    serve(load)
