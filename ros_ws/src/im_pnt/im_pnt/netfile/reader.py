"""What is written in a file to a :class:`~im_pnt.net.Net`."""

from collections.abc import Collection, Mapping

from im_pnt.expand import INPUT_SEMAPHORE, OUTPUT_SEMAPHORE
from im_pnt.net import Net, Place, Service
from im_pnt.netfile import keys
from im_pnt.netfile.actions import required
from im_pnt.netfile.names import checked, checked_key, is_name, known_place
from im_pnt.netfile.node import Node
from im_pnt.netfile.transitions import read_transition


def read_net(root: Node, *, foreign: bool = False) -> Net:
    """Reads a net.

    Args:
        root: The file, without includes and templates.
        foreign: Whether the net comes from another tool: its places and transitions may have any names, as long as
            nothing is asked for that needs names of ours.

    Raises:
        NetFileError: It is not a net; names file, line, column and what is allowed.
    """
    entries = root.items(keys.NET)
    required(root, entries, "net", "places", "transitions")
    name = checked(entries["net"])
    written = entries["places"].items()
    for key, node in written.items() if not foreign else ():
        if checked_key(node, key) in (INPUT_SEMAPHORE, OUTPUT_SEMAPHORE):
            raise node.key_error(f"the name '{key}' belongs to the coordination structure")
    places = {key: _place(key, node, written) for key, node in written.items()}
    services = _services(entries["services"], places) if "services" in entries else {}
    escalate = known_place(entries["escalate"], places) if "escalate" in entries else None
    rest = None
    if "rest" in entries:
        rest = tuple(known_place(element, places) for element in entries["rest"].elements())
    transitions = {}
    for key, node in entries["transitions"].items().items():
        if not foreign:
            checked_key(node, key)
        transitions[key] = read_transition(key, node, net=name, places=places, escalate=escalate, foreign=foreign)
    if not transitions:
        raise entries["transitions"].error("the net has no transition")
    description = entries["description"].text() if "description" in entries else ""
    net = Net(name, places, transitions, services, escalate, rest, description, root.file)
    if foreign:
        _require_names(net, entries)
    return net


def _require_names(net: Net, entries: Mapping[str, Node]) -> None:
    """Sees to it that no name of another tool is one that expansion makes."""
    ours = net.services or any(place.on_invalid or place.remote for place in net.places.values())
    if not ours and not any(t.action or t.remote_outputs for t in net.transitions.values()):
        return
    for section in ("places", "transitions"):
        for name, node in entries[section].items().items():
            if not is_name(name) or name in (INPUT_SEMAPHORE, OUTPUT_SEMAPHORE):
                raise node.key_error(f"'{name}' is not a name that a net with actions or services can have")


def _place(name: str, node: Node, places: Collection[str]) -> Place:
    if node.is_null:
        return Place(name)
    if not node.is_mapping:
        return Place(name, tokens=node.integer(0))
    entries = node.items(keys.PLACE)
    tokens = entries["tokens"].integer(0) if "tokens" in entries else 0
    capacity = entries["capacity"].integer(1) if "capacity" in entries else None
    if capacity is not None and tokens > capacity:
        raise node.error(f"{tokens} tokens are more than the capacity of {capacity}")
    data_object = entries["data_object"].text() if "data_object" in entries else None
    on_invalid: tuple[str, ...] = ()
    if "on_invalid" in entries:
        if data_object is None:
            raise entries["on_invalid"].key_error("needs a data_object whose loss of validity it answers")
        on_invalid = tuple(known_place(element, places) for element in entries["on_invalid"].elements())
    remote = entries["remote"].boolean() if "remote" in entries else False
    return Place(name, tokens, capacity, data_object, on_invalid, remote)


def _services(node: Node, places: Collection[str]) -> dict[str, Service]:
    services: dict[str, Service] = {}
    for name, entry in node.items().items():
        checked_key(entry, name)
        parts = entry.items(keys.SERVICE)
        required(entry, parts, *keys.SERVICE)
        ends = {key: known_place(parts[key], places) for key in keys.SERVICE}
        if len(set(ends.values())) < len(ends):
            raise entry.error("entry, done and failed must be three different places")
        services[name] = Service(name, **ends)
    return services
