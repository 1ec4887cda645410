"""Meanings of names at the transitions of a net, and the check of all values when it is loaded.

``arguments`` are those of the command or request whose tokens a transition may take; which these are follows from the
arcs. ``answers`` are what earlier actions of the same command were answered.
"""

from collections.abc import Iterator, Mapping
from functools import partial

from im_core.errors import ImError, nearest, quoted_text
from im_core.text.yamltext import Location
from im_pnt.errors import NetFileError
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import as_text
from im_pnt.expression.inference import Meanings, infer
from im_pnt.expression.template import OPENS, nodes, pieces, references
from im_pnt.expression.types import (
    ANY,
    BOOLEAN,
    NUMBER,
    TEXT,
    MessageTypes,
    ValueKind,
    ValueType,
    argument_type,
    message_type,
)
from im_pnt.model.action import AwaitAction, GoalAction, RequestAction, ServiceAction, TopicAction
from im_pnt.model.net import Net, Transition
from im_pnt.model.resources import resource_places

_FIELDS = {ServiceAction: ("service", "request"), GoalAction: ("goal", "goal"), TopicAction: ("topic", "message")}
SENT = {ServiceAction: "_Request", GoalAction: "_Goal", TopicAction: ""}
ANSWERED = {ServiceAction: "_Response", GoalAction: "_Result", AwaitAction: ""}


class PlacedError(ExpressionError):
    """Fault of a value, and the place.

    Args:
        location: Where, below the value that was looked at.
        sentence: What.
    """

    def __init__(self, location: Location, sentence: str) -> None:
        super().__init__(sentence)
        self.location, self.sentence = location, sentence


def check_net(net: Net, types: MessageTypes) -> None:
    """Check all values in requests, objects, results and guards of a net.

    Raises:
        NetFileError: One does not fit; names file, line, column, key, and what is allowed.
    """
    scope = NetScope(net, types)
    for transition in net.transitions.values():
        location: Location = ()
        try:
            for location, value, wanted in _values(net, transition):
                check_value(value, wanted, scope.meanings(transition), location)
        except PlacedError as error:
            raise _complaint(net, transition, error.location, error.sentence) from error
        except ImError as error:  # there is no such type of messages
            raise _complaint(net, transition, (*location[:1], "type"), error.message) from error


def _complaint(net: Net, transition: Transition, location: Location, sentence: str) -> NetFileError:
    where = f"transitions.{transition.name}"
    for key in location:
        where += f"[{key}]" if isinstance(key, int) else f".{key}"
    mark = None
    while mark is None and location:
        mark, location = transition.marks.get(location), location[:-1]
    if mark is None:
        return NetFileError(transition.file or net.source, transition.line, f"{where}: {sentence}")
    return NetFileError(mark.file, mark.line, f"{where}: {sentence}{mark.note}", mark.column)


def _values(net: Net, transition: Transition) -> Iterator[tuple[Location, object, ValueType]]:
    """Yield the places of a transition's values, the values, and the wanted types."""
    action = transition.action
    if isinstance(action, GoalAction):
        yield ("goal", "name"), action.name, ANY
    if isinstance(action, ServiceAction | GoalAction | TopicAction):
        yield _FIELDS[type(action)], dict(action.fields), message_type(f"{action.type}{SENT[type(action)]}")
    elif isinstance(action, AwaitAction):
        yield ("await",), {}, message_type(action.type)
        if action.until is not None:
            yield ("await", "until"), action.until, BOOLEAN
    elif isinstance(action, RequestAction):
        yield ("request", "arguments"), dict(action.fields), ANY
    if transition.guard is not None and OPENS in transition.guard.name:
        yield ("guard",), transition.guard.name, BOOLEAN
    for path in (path for node in nodes(transition.says) for path in references(node)):
        if path[:2] == ("answers", transition.name):
            raise PlacedError(("says",), f"answers.{transition.name} is not known as the action begins")
    yield ("says",), transition.says, ANY
    context = "" if transition.strategy is None else transition.strategy.context
    if any(path[0] != "arguments" for node in nodes(context) for path in references(node)):
        sentence = "names more than arguments; answers and data are not known as the action begins"
        raise PlacedError(("strategy", "context"), sentence)
    yield ("strategy", "context"), context, ANY
    for name, value in transition.result.items():
        yield ("result", name), value, ANY
    for name, value in transition.store.items():
        yield ("store", name), value, _object_type(net, name)


def _object_type(net: Net, name: str) -> ValueType:
    """Return the type of a data object.

    Raises:
        PlacedError: No place says it.
    """
    places = [place for place in net.places.values() if place.data_object == name]
    typed = next((place.object_type for place in places if place.object_type), None)
    if typed is not None:
        return message_type(typed)
    known = [place.data_object for place in net.places.values() if place.data_object]
    hint = "" if places else nearest(name, known)
    says = f"data_object: {{name: {name}, type: package/msg/Type}}"
    raise PlacedError(("store", name), f"no place says of what type data object '{name}' is, as in {says}{hint}")


class NetScope:
    """Meanings of names in a net."""

    def __init__(self, net: Net, types: MessageTypes) -> None:
        self.net, self._types = net, types
        self._works: Mapping[str, frozenset[str]] | None = None

    def meanings(self, transition: Transition) -> Meanings:
        """Return the meanings of names at a transition."""
        return Meanings(partial(self._argument, transition), partial(self._answer, transition), self._data, self._types)

    def works_for(self, transition: Transition) -> frozenset[str]:
        """Return the possible commands and services of a transition, by symbol and name."""
        if self._works is None:
            self._works = _works(self.net)
        return self._works[transition.name]

    def _for_whom(self, transition: Transition, what: str) -> frozenset[str]:
        kinds = self.works_for(transition)
        if not kinds:
            raise ExpressionError(f"{what}: the tokens of this transition belong to no command or request")
        return kinds

    def _argument(self, transition: Transition, name: str) -> ValueType:
        kinds = self._for_whom(transition, f"arguments.{name}")
        found: set[ValueType] = set()
        for kind in sorted(kinds):
            schema = self.net.arguments_of(kind)
            if schema is None:
                found.add(ANY)
            elif name in schema.arguments:
                found.add(argument_type(schema.arguments[name]))
            else:
                hint = nearest(name, schema.arguments) or "; it takes none"
                raise ExpressionError(f"arguments.{name}: {kind}, served here, has no such argument{hint}")
        if len(found) == 1:
            return found.pop()
        return NUMBER if all(kind.is_number and kind != ANY for kind in found) else ANY

    def _answer(self, at: Transition, name: str) -> ValueType:
        self._for_whom(at, f"answers.{name}")
        transition = self.net.transitions.get(name)
        if transition is None:
            raise ExpressionError(
                f"answers.{name}: there is no transition '{name}'{nearest(name, answering(self.net))}"
            )
        action = transition.action
        if isinstance(action, RequestAction):
            return ANY
        if isinstance(action, ServiceAction | GoalAction | AwaitAction):
            return message_type(f"{action.type}{ANSWERED[type(action)]}")
        raise ExpressionError(
            f"answers.{name}: transition '{name}' is not answered{nearest(name, answering(self.net))}"
        )

    def _data(self, name: str) -> ValueType:
        try:
            return _object_type(self.net, name)
        except PlacedError as error:
            raise ExpressionError(f"data.{name}: {error.sentence}") from error


def answering(net: Net) -> list[str]:
    """Return the transitions with answered actions."""
    kinds = (ServiceAction, GoalAction, AwaitAction, RequestAction)
    return [name for name, transition in net.transitions.items() if isinstance(transition.action, kinds)]


def _works(net: Net) -> dict[str, frozenset[str]]:
    """Return for each transition the commands and services with tokens able to come along the arcs."""
    resources = resource_places(net)
    carried: dict[str, set[str]] = {name: set() for name in net.places}
    for service in net.services.values():
        carried[service.entry].add(service.name)
    works: dict[str, set[str]] = {name: set() for name in net.transitions}
    escalate = () if net.escalate is None else (net.escalate,)
    changed = True
    while changed:
        changed = False
        for name, transition in net.transitions.items():
            kinds = set[str]().union(*(carried[place] for place in transition.inputs if place not in resources))
            if transition.symbol is not None and transition.symbol_of is None:
                kinds.add(transition.symbol)
            if not kinds <= works[name]:
                works[name] |= kinds
                changed = True
            failing = (transition.on_failure or escalate) if transition.action is not None else ()
            for place in (*transition.outputs, *failing, *transition.on_doubt):
                carried[place] |= kinds
        for place in net.places.values():
            for other in place.on_invalid:
                if not carried[place.name] <= carried[other]:
                    carried[other] |= carried[place.name]
                    changed = True
    return {name: frozenset(kinds) for name, kinds in works.items()}


def check_value(value: object, wanted: ValueType, meanings: Meanings, location: Location = ()) -> None:
    """Check a value against a wanted type, field by field.

    Raises:
        PlacedError: It does not fit; says where, and what is allowed.
    """
    if isinstance(value, str) and OPENS in value:
        _check_text(value, wanted, meanings, location)
    elif isinstance(value, dict):
        _check_fields(value, wanted, meanings, location)
    elif isinstance(value, list | tuple):
        if wanted.kind not in (ValueKind.LIST, ValueKind.ANY):
            raise PlacedError(location, f"a list is not {wanted}")
        limit = wanted.longest if wanted.longest is not None else len(value)
        if (wanted.length is not None and len(value) != wanted.length) or len(value) > limit:
            raise PlacedError(location, f"a list of {len(value)} is not {wanted}")
        for rank, each in enumerate(value):
            check_value(each, wanted.element or ANY, meanings, (*location, rank))
    elif not _is(value, wanted):
        raise PlacedError(location, f"{_shown(value)} is not {wanted}")


def _check_text(text: str, wanted: ValueType, meanings: Meanings, location: Location) -> None:
    try:
        parts = pieces(text)
        found = [TEXT if isinstance(part, str) else infer(part, meanings) for part in parts]
    except ExpressionError as error:
        raise PlacedError(location, str(error)) from error
    kind = found[0] if len(found) == 1 else TEXT
    if not kind.fits(wanted):
        raise PlacedError(location, f"{quoted_text(text)} is {kind}, not {wanted}")


def _check_fields(fields: dict[str, object], wanted: ValueType, meanings: Meanings, location: Location) -> None:
    known = meanings.types.fields(wanted.message) if wanted.kind is ValueKind.MESSAGE else None
    if wanted.kind not in (ValueKind.MESSAGE, ValueKind.ANY):
        raise PlacedError(location, f"a mapping is not {wanted}")
    for name, value in fields.items():
        if known is not None and name not in known:
            raise PlacedError((*location, name), f"{wanted.message} has no field '{name}'{nearest(name, known)}")
        check_value(value, ANY if known is None else known[name], meanings, (*location, name))


def _is(value: object, wanted: ValueType) -> bool:
    match wanted.kind:
        case ValueKind.ANY:
            return True
        case ValueKind.BOOLEAN:
            return isinstance(value, bool)
        case ValueKind.INTEGER:
            if isinstance(value, bool) or not isinstance(value, int):
                return False
            lowest, highest = wanted.lowest, wanted.highest
            return (lowest is None or value >= lowest) and (highest is None or value <= highest)
        case ValueKind.NUMBER:
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ValueKind.TEXT:
            return isinstance(value, str) and (wanted.longest is None or len(value) <= wanted.longest)
        case _:
            return False


def _shown(value: object) -> str:
    return "nothing" if value is None else quoted_text(as_text(value))
