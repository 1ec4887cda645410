"""Writer of nets as YAML, in an author's style: a line a place, a line a key of a transition; inverse of reading."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields

from im_pnt.errors import NetError
from im_pnt.model.action import (
    Action,
    AwaitAction,
    FunctionAction,
    RequestAction,
    ServiceAction,
    TopicAction,
    ValuesAction,
)
from im_pnt.model.arguments import Argument, ArgumentSchema, Busy, CommandDeclaration
from im_pnt.model.delay import Delay
from im_pnt.model.net import (
    LARGEST,
    Arcs,
    Assumption,
    Net,
    ObjectScope,
    Place,
    RemotePlace,
    Role,
    Service,
    Strategy,
    Transition,
)

_BARE = re.compile(r"[A-Za-z_/][A-Za-z0-9_./]*( [A-Za-z0-9_./]+)*")
_UNPRINTABLE = re.compile("[^\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]")
_OTHERWISE = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})
"""Words that YAML 1.1 or 1.2 takes for something else than a text."""


def yaml_text(net: Net) -> str:
    """Return a net as the text of a YAML file.

    Raises:
        NetError: An expanded net.
    """
    return "\n".join([*_lines(describe(net)), ""])


def describe(net: Net) -> dict[str, object]:
    """Return a net as plain data under the keys of net files, in the order of an author.

    Raises:
        NetError: An expanded net, which no file can hold.
    """
    if any(transition.role is not Role.PLAIN for transition in net.transitions.values()):
        raise NetError(f"net {net.name} is expanded; write the net before its expansion", net=net.name)
    return {
        "net": net.name,
        **_filled(description=net.description, former=net.former),
        "places": {name: place_data(place) for name, place in net.places.items()},
        **_filled(
            services={name: _service_data(service) for name, service in net.services.items()},
            commands={symbol: _command_data(command) for symbol, command in net.commands.items()},
            assume={name: _assumption_data(assumption) for name, assumption in net.assume.items()},
        ),
        **_said(
            at_once=None if net.at_once == 1 else net.at_once,
            escalate=net.escalate,
            rest=None if net.rest is None else list(net.rest),
        ),
        "transitions": {name: transition_data(t) for name, t in net.transitions.items()},
    }


def place_data(place: Place) -> dict[str, object]:
    """Return the written form of a place."""
    return _said(
        title=place.title or None,
        tokens=place.tokens or None,
        capacity=place.capacity,
        data_object=None if place.data_object is None else _object_data(place),
        on_invalid=list(place.on_invalid) or None,
        remote=place.remote or None,
        resource=place.resource,
    )


def _object_data(place: Place) -> object:
    said = _filled(type=place.object_type)
    if place.object_scope is not ObjectScope.COMMAND:
        said["scope"] = place.object_scope.value
    return {"name": place.data_object, **said} if said else place.data_object


def _service_data(service: Service) -> dict[str, object]:
    taken = None if service.arguments is None else schema_data(service.arguments)
    ends = {"entry": service.entry, "done": service.done, "failed": service.failed}
    return {**ends, **_said(arguments=taken), **_acts_on_data(service.acts_on)}


def _acts_on_data(said: tuple[str, ...] | None) -> dict[str, object]:
    return {} if said is None else {"acts_on": list(said)}


def _command_data(command: CommandDeclaration) -> dict[str, object]:
    busy = "" if command.busy is Busy.WAIT else command.busy.value
    arguments, needs = schema_data(command.arguments), list(command.needs)
    said = {"description": command.description, "arguments": arguments, "needs": needs, "busy": busy}
    return _filled(**said, priority=command.priority)


def _assumption_data(assumption: Assumption) -> dict[str, object]:
    if assumption.returns is not None:
        return {"returns": str(assumption.returns)}
    return {"at_most": assumption.at_most}


def schema_data(schema: ArgumentSchema) -> dict[str, object]:
    """Return the written form of an argument schema."""
    return {name: _argument_data(argument) for name, argument in schema.arguments.items()}


def _argument_data(argument: Argument) -> dict[str, object]:
    data: dict[str, object] = {"type": argument.type.value, **_filled(unit=argument.unit), **argument.limits()}
    if argument.choices:
        data["choices"] = list(argument.choices)
    if argument.length is not None:
        least, most = argument.length
        data["length"] = least if least == most else [least, most]
    if not argument.required:
        data["default"] = argument.default
    return data | _filled(help=argument.help)


def transition_data(transition: Transition) -> dict[str, object]:
    """Return the written form of a transition."""
    t = transition
    outputs = {**t.outputs, **{str(place): weight for place, weight in t.remote_outputs.items()}}
    return {
        **_filled(title=t.title),
        **_said(symbol=None if t.symbol is None else _symbol_data(t)),
        **_filled(**{"in": arcs_data(t.inputs)}, inhibitors=arcs_data(t.inhibitors), resets=list(t.resets)),
        **_filled(guard=None if t.guard is None else str(t.guard), out=arcs_data(outputs)),
        **_action_data(t.action),
        **_acts_on_data(t.acts_on),
        **_filled(says=t.says),
        **_filled(result=dict(t.result), store=dict(t.store)),
        **_said(timeout=t.timeout),
        **_filled(on_failure=arcs_data(t.on_failure), on_doubt=arcs_data(t.on_doubt)),
        **_said(
            retry_of=t.retry_of,
            cancels=t.cancels,
            keeps_failure=t.keeps_failure or None,
            emit=list(t.emit) or None,
            delay=None if t.delay is None else _delay_data(t.delay),
            success=None if t.success == 1.0 else t.success,
            weight=None if t.weight == 1.0 else t.weight,
            strategy=None if t.strategy is None else _strategy_data(t.strategy),
            priority=t.priority or None,
            servers="inf" if t.servers == LARGEST else t.servers,
        ),
    }


def arcs_data(arcs: Arcs) -> list[str] | dict[str, int]:
    """Return arcs as a list where every weight is 1, else as a mapping."""
    return list(arcs) if all(weight == 1 for weight in arcs.values()) else dict(arcs)


def _action_data(action: Action | None) -> dict[str, object]:
    match action:
        case None | ValuesAction():  # what only returns and stores values is written as these
            return {}
        case FunctionAction(function):
            return {"action": function}
        case RequestAction(net, service, arguments, build):
            to = str(RemotePlace(net, service))
            more = _filled(arguments=dict(arguments), build=build)
            return {"request": {"to": to, **more} if more else to}
    data: dict[str, object] = {"name": action.name, "type": action.type}
    if isinstance(action, AwaitAction):
        return {
            "await": data
            | _filled(latched=action.latched, until=action.until, handle=action.handle, silent=action.silent)
        }
    if isinstance(action, TopicAction):
        return {"topic": data | _filled(message=dict(action.fields), build=action.build)}
    kind, fields = ("service", "request") if isinstance(action, ServiceAction) else ("goal", "goal")
    rest = _filled(build=action.build, handle=action.handle, task=action.task)
    return {kind: data | ({fields: dict(action.fields)} if action.fields else {}) | rest}


def _filled(**values: object) -> dict[str, object]:
    """Return the values that are not empty."""
    return {name: value for name, value in values.items() if value}


def _said(**values: object) -> dict[str, object]:
    """Return the values that are not None."""
    return {name: value for name, value in values.items() if value is not None}


def _delay_data(delay: Delay) -> float | Mapping[str, object]:
    return delay.values[0] if delay.kind == "constant" else {delay.kind: delay.parameters()}


def _symbol_data(transition: Transition) -> object:
    of = None if transition.symbol_of is None else transition.symbol_of.value
    said = _said(of=of, expires=transition.symbol_expires)
    return {"name": transition.symbol, **said} if said else transition.symbol


def _strategy_data(strategy: Strategy) -> dict[str, object]:
    start = Strategy()
    names = [field.name for field in fields(strategy)]
    return {name: getattr(strategy, name) for name in names if getattr(strategy, name) != getattr(start, name)}


def _lines(data: Mapping[str, object]) -> Iterator[str]:
    for key, value in data.items():
        if key == "transitions" and isinstance(value, Mapping):
            yield from ("", "transitions:" if value else "transitions: {}")
            for name, transition in value.items():
                yield f"  {_flow(name)}:" if transition else f"  {_flow(name)}: {{}}"
                yield from (f"    {key}: {_flow(entry)}" for key, entry in transition.items())
        elif key in ("places", "services", "commands", "assume") and isinstance(value, Mapping):
            yield from ("", f"{key}:" if value else f"{key}: {{}}")
            yield from (_place(name, entry) for name, entry in value.items())
        else:
            yield f"{key}: {_flow(value)}"


def _place(name: str, data: Mapping[str, object]) -> str:
    if not data:
        return f"  {_flow(name)}:"
    return f"  {_flow(name)}: {_flow(data['tokens'] if data.keys() == {'tokens'} else data)}"


def _flow(value: object) -> str:
    """Write a value in one line; ambiguous texts in quotes."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_flow(key)}: {_flow(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str):
        bare = _BARE.fullmatch(value) and value.lower() not in _OTHERWISE
        return value if bare else _UNPRINTABLE.sub(_escaped, json.dumps(value, ensure_ascii=False))
    return json.dumps(value)


def _escaped(match: re.Match[str]) -> str:
    return f"\\U{ord(match.group()):08x}"
