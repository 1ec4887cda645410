"""Check of assumptions on other nets: each must have a meaning."""

from collections.abc import Iterator

from im_core.errors import nearest
from im_core.text.yamltext import Location
from im_pnt.model.net import Assumption, Net
from im_pnt.netfile.schema.names import shown_name


def faults(net: Net) -> Iterator[tuple[Location, str]]:
    """Yield the faults of the assumptions of a net, and the places in the file."""
    for name, assumption in net.assume.items():
        for key, sentence in _faults(net, name, assumption):
            yield (("assume", name, key) if key else ("assume", name)), sentence


def _faults(net: Net, name: str, assumption: Assumption) -> Iterator[tuple[str, str]]:
    remote = {place.name for place in net.places.values() if place.remote}
    if name not in remote:
        if name not in net.services:
            known = {*remote, *net.services}
            yield "", f"there is no remote place and no service '{shown_name(name)}'{nearest(name, known)}"
        elif assumption.returns is not None:
            yield "returns", f"'{shown_name(name)}' is a service, to which no token comes back"
        return
    if name in net.services:
        yield "", f"'{shown_name(name)}' is a remote place and a service; rename one of them"
    for marking in _marked_by(net, name):
        yield "", f"{marking} marks '{shown_name(name)}' too; what is assumed of a place is that other nets mark it"
        break
    tokens = net.places[name].tokens
    if assumption.at_most is not None and assumption.at_most < tokens:
        less = f"{assumption.at_most} is less than the {tokens} tokens"
        yield "at_most", f"{less} that are in '{shown_name(name)}' at first"
    sent = {target for transition in net.transitions.values() for target in transition.remote_outputs}
    if assumption.returns is not None and assumption.returns not in sent:
        near = nearest(str(assumption.returns), map(str, sent))
        yield "returns", f"no transition sends a token to '{assumption.returns}'{near}"


def _marked_by(net: Net, name: str) -> Iterator[str]:
    """Yield the transitions, services and places of the same net marking a place."""
    for transition in net.transitions.values():
        if name in {**transition.outputs, **transition.on_failure, **transition.on_doubt}:
            yield f"transition '{transition.name}'"
    for service in net.services.values():
        if service.entry == name:
            yield f"service '{service.name}'"
    for place in net.places.values():
        if name in place.on_invalid:
            yield f"place '{place.name}'"
    if net.escalate == name:
        yield "'escalate'"
