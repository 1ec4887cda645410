"""Meanings of names at the transitions of a net, the needed fields of answers, and the check of all values.

``arguments`` are those of the command or request whose tokens a transition may take; which these are follows from the
arcs. ``answers`` are what earlier actions of the same command were answered.
"""

from collections.abc import Iterator, Mapping
from functools import partial

from im_core.errors import ImError, nearest
from im_core.yamltext import Location
from im_pnt.errors import NetFileError
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.inference import Meanings
from im_pnt.expression.template import OPENS, PlacedError, check_value, nodes, references
from im_pnt.expression.types import (
    ANY,
    BOOLEAN,
    NUMBER,
    MessageTypes,
    ValueType,
    argument_type,
    message_type,
)
from im_pnt.model.action import AwaitAction, GoalAction, RequestAction, ServiceAction, TopicAction
from im_pnt.model.net import Net, Transition
from im_pnt.model.resources import resource_places

_FIELDS = {ServiceAction: ("service", "request"), GoalAction: ("goal", "goal"), TopicAction: ("topic", "message")}
_SENT = {ServiceAction: "_Request", GoalAction: "_Goal", TopicAction: ""}
_ANSWERED = {ServiceAction: "_Response", GoalAction: "_Result", AwaitAction: ""}


def check_net(net: Net, types: MessageTypes) -> None:
    """Check all values in requests, objects, results and guards of a net.

    Args:
        net: The net as written.
        types: Looks up the fields of messages.

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
        return NetFileError(net.source, transition.line, f"{where}: {sentence}")
    return NetFileError(mark.file, mark.line, f"{where}: {sentence}{mark.note}", mark.column)


def _values(net: Net, transition: Transition) -> Iterator[tuple[Location, object, ValueType]]:
    """Yield the places of a transition's values, the values, and the wanted types."""
    action = transition.action
    if isinstance(action, ServiceAction | GoalAction | TopicAction):
        yield _FIELDS[type(action)], dict(action.fields), message_type(f"{action.type}{_SENT[type(action)]}")
    elif isinstance(action, AwaitAction):
        yield ("await",), {}, message_type(action.type)
        if action.until is not None:
            yield ("await", "until"), action.until, BOOLEAN
    elif isinstance(action, RequestAction):
        yield ("request", "arguments"), dict(action.fields), ANY
    if transition.guard is not None and OPENS in transition.guard.name:
        yield ("guard",), transition.guard.name, BOOLEAN
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
    """Meanings of names in a net.

    Args:
        net: The net as written.
        types: Looks up the fields of messages.

    Attributes:
        net: As given.
    """

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
            return message_type(f"{action.type}{_ANSWERED[type(action)]}")
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


# What is read, and has to be kept or followed.


Way = tuple[str, ...]
"""Names that lead to a field, through lists too."""


def read_answers(net: Net) -> dict[str, tuple[Way, ...]]:
    """Return the needed fields of answers, by transition: ways to fields, none within another."""
    values: list[object] = []
    for transition in net.transitions.values():
        guard = transition.guard.name if transition.guard is not None else ""
        until = getattr(transition.action, "until", None) or ""
        values += [getattr(transition.action, "fields", {}), until, guard, transition.result, transition.store]
    return _ways(values, "answers")


def read_objects(value: object) -> dict[str, tuple[Way, ...]]:
    """Return the needed fields of data objects in expressions of a value, by object."""
    return _ways(value, "data")


def _ways(value: object, root: str) -> dict[str, tuple[Way, ...]]:
    ways: dict[str, set[Way]] = {}
    for node in nodes(value):
        for path in references(node):
            if path[0] == root:
                ways.setdefault(path[1], set()).add(path[2:])
    return {name: tuple(sorted(way for way in found if not _covered(way, found))) for name, found in ways.items()}


def _covered(way: Way, others: set[Way]) -> bool:
    return any(way[:count] in others for count in range(len(way)))
