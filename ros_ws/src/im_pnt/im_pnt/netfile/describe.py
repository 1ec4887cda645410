"""A net as what its file would say: the inverse of reading."""

from collections.abc import Mapping

from im_pnt.action import Action, FunctionAction, RequestAction, ServiceAction, TopicAction
from im_pnt.delay import Delay
from im_pnt.errors import NetError
from im_pnt.net import Arcs, Net, Place, RemotePlace, Role, Strategy, Transition


def describe(net: Net) -> dict[str, object]:
    """Returns a net as plain data under the keys of net files, in the order in which an author writes them.

    Raises:
        NetError: An expanded net, which no file can hold.
    """
    if any(transition.role is not Role.PLAIN for transition in net.transitions.values()):
        raise NetError(f"net {net.name} is expanded; what is written is the net that it was made from", net=net.name)
    data: dict[str, object] = {"net": net.name}
    if net.description:
        data["description"] = net.description
    data["places"] = {name: place_data(place) for name, place in net.places.items()}
    if net.services:
        services = net.services.values()
        data["services"] = {s.name: {"entry": s.entry, "done": s.done, "failed": s.failed} for s in services}
    if net.escalate is not None:
        data["escalate"] = net.escalate
    if net.rest is not None:
        data["rest"] = list(net.rest)
    data["transitions"] = {name: transition_data(t) for name, t in net.transitions.items()}
    return data


def place_data(place: Place) -> dict[str, object]:
    """Returns what is written about a place."""
    data: dict[str, object] = {}
    if place.tokens:
        data["tokens"] = place.tokens
    if place.capacity is not None:
        data["capacity"] = place.capacity
    if place.data_object is not None:
        data["data_object"] = place.data_object
    if place.on_invalid:
        data["on_invalid"] = list(place.on_invalid)
    if place.remote:
        data["remote"] = True
    return data


def transition_data(transition: Transition) -> dict[str, object]:
    """Returns what is written about a transition."""
    t, data = transition, dict[str, object]()
    if t.symbol is not None:
        data["symbol"] = t.symbol
    if t.inputs:
        data["in"] = arcs_data(t.inputs)
    if t.inhibitors:
        data["inhibitors"] = arcs_data(t.inhibitors)
    if t.guard is not None:
        data["guard"] = str(t.guard)
    if t.outputs or t.remote_outputs:
        data["out"] = arcs_data({**t.outputs, **{str(place): weight for place, weight in t.remote_outputs.items()}})
    if t.action is not None:
        kind, value = _action_data(t.action)
        data[kind] = value
    if t.timeout is not None:
        data["timeout"] = t.timeout
    if t.on_failure:
        data["on_failure"] = arcs_data(t.on_failure)
    if t.on_doubt:
        data["on_doubt"] = arcs_data(t.on_doubt)
    if t.emit:
        data["emit"] = list(t.emit)
    if t.delay is not None:
        data["delay"] = _delay_data(t.delay)
    if t.success != 1.0:
        data["success"] = t.success
    if t.weight != 1.0:
        data["weight"] = t.weight
    if t.strategy is not None:
        data["strategy"] = _strategy_data(t.strategy)
    if t.priority:
        data["priority"] = t.priority
    return data


def arcs_data(arcs: Arcs) -> list[str] | dict[str, int]:
    """Returns arcs as a list where every weight is 1, else as a mapping."""
    return list(arcs) if all(weight == 1 for weight in arcs.values()) else dict(arcs)


def _action_data(action: Action) -> tuple[str, object]:
    if isinstance(action, FunctionAction):
        return "action", action.function
    if isinstance(action, RequestAction):
        to = str(RemotePlace(action.net, action.service))
        more = _filled(arguments=dict(action.fields), build=action.build)
        return "request", {"to": to, **more} if more else to
    data: dict[str, object] = {"name": action.name, "type": action.type}
    if isinstance(action, TopicAction):
        return "topic", data | _filled(message=dict(action.fields), build=action.build)
    kind, fields = ("service", "request") if isinstance(action, ServiceAction) else ("goal", "goal")
    rest = _filled(build=action.build, handle=action.handle, task=action.task)
    return kind, data | ({fields: dict(action.fields)} if action.fields else {}) | rest


def _filled(**values: object) -> dict[str, object]:
    return {name: value for name, value in values.items() if value}


def _delay_data(delay: Delay) -> float | Mapping[str, object]:
    return delay.values[0] if delay.kind == "constant" else {delay.kind: delay.parameters()}


def _strategy_data(strategy: Strategy) -> dict[str, float]:
    start = Strategy()
    names = ("successes", "failures", "decay")
    return {name: getattr(strategy, name) for name in names if getattr(strategy, name) != getattr(start, name)}
