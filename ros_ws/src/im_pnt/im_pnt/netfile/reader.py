"""Content of a file as a :class:`~im_pnt.model.net.Net`: rules over several parts, and existing names."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from im_core.errors import DataError, nearest
from im_core.text.yamltext import Kind, Location, Value, find
from im_pnt.errors import NetError, NetFileError
from im_pnt.expression.scope import check_net
from im_pnt.expression.types import NoTypes
from im_pnt.model.action import (
    Action,
    AwaitAction,
    FunctionAction,
    GoalAction,
    RequestAction,
    ServiceAction,
    TopicAction,
    ValuesAction,
)
from im_pnt.model.arguments import Argument, ArgumentSchema, ArgumentType, Busy, CommandDeclaration
from im_pnt.model.delay import Delay
from im_pnt.model.expand import INPUT_SEMAPHORE, MADE, MADE_OF_SERVICES, OUTPUT_SEMAPHORE
from im_pnt.model.net import (
    OTHERWISE,
    Assumption,
    Guard,
    Mark,
    Net,
    ObjectScope,
    Place,
    ReadFor,
    RemotePlace,
    Service,
    Strategy,
    Transition,
)
from im_pnt.model.resources import resource_places
from im_pnt.netfile.assume import faults
from im_pnt.netfile.schema.commands import ArgumentFile
from im_pnt.netfile.schema.delays import DelayFile
from im_pnt.netfile.schema.names import is_name, is_qualified, shown_name
from im_pnt.netfile.schema.net import AssumptionFile, NetFile
from im_pnt.netfile.schema.places import PlaceFile
from im_pnt.netfile.schema.transitions import TransitionFile
from im_pnt.netfile.text import checked, complaint_at, read_data
from im_pnt.netfile.tries import written_out

MOST_WAYS = 256
"""In which a transition may find the places that it empties: verification looks at each by itself."""


def read_net(root: Value, *, foreign: bool = False) -> Net:
    """Read a net.

    Args:
        root: The file, without includes and templates.
        foreign: Whether the net comes from another tool: its places and transitions may have any names, as long as
            nothing is asked for that needs names of ours.

    Raises:
        NetFileError: It is not a net; names file, line, column and what is allowed.
    """
    file = checked(root, read_data(root), NetFile, lambda data: NetFile.model_validate(data, context=foreign))
    return _Reader(root, file, foreign=foreign).net()


class _Reader:
    """Reader of a file with sound parts, and with the place of each."""

    def __init__(self, root: Value, file: NetFile, *, foreign: bool) -> None:
        self._root, self._file, self._foreign = root, file, foreign
        keys = (key for section, value in root.pairs if section.text == "transitions" for key, _ in value.pairs)
        self._keys = {key.text: key for key in keys}

    def net(self) -> Net:
        """Make the net."""
        file = self._file
        for key in ("places", "transitions"):
            if key not in file.model_fields_set:
                raise self._error((), f"'{key}' is missing")
        places = {name: self._place(name, place) for name, place in file.places.items()}
        services = {}
        for name, service in file.services.items():
            ends = {"entry": service.entry, "done": service.done, "failed": service.failed}
            for key, place in ends.items():
                self._known(("services", name, key), place)
            here: Location = ("services", name, "arguments")
            taken = None if service.arguments is None else self._schema(here, service.arguments)
            services[name] = Service(name, **ends, arguments=taken, acts_on=service.acts_on)
        if "at_once" in file.model_fields_set and not services:
            raise self._error(("at_once",), "is for requests to services, and the net offers none")
        if file.escalate is not None:
            self._known(("escalate",), file.escalate)
        for rank, name in enumerate(file.rest or ()):
            self._known(("rest", rank), name)
        transitions = {name: self._transition(name, each) for name, each in file.transitions.items()}
        if not transitions:
            raise self._error(("transitions",), "the net has no transition")
        self._add_tries(places, transitions)  # before the checks below, which hold for further tries too
        self._require_one_reading(transitions)
        self._require_arguments(places)
        net = Net(
            file.net,
            places,
            transitions,
            services,
            file.escalate,
            file.rest,
            file.description,
            self._root.file,
            self._commands(transitions),
            {name: _assumption(each) for name, each in file.assume.items()},
            file.at_once,
            file.former or "",
        )
        for at, sentence in faults(net):
            raise self._error(at, sentence, key=True)
        if self._foreign:
            self._require_names(net)
        self._require_free_names(net)
        self._require_countable(net)
        check_net(net, NoTypes())
        return replace(net, transitions=dict(self._with_otherwise(net)))

    def _require_free_names(self, net: Net) -> None:
        """Refuse names with a dot that the expansion gives to its own parts."""
        sections: Iterable[tuple[str, Iterable[str]]] = (("places", net.places), ("transitions", net.transitions))
        for section, names in sections:
            for name in names:
                first, _, last = name.rpartition(".")
                transition, place = net.transitions.get(first), net.places.get(first)
                of_part = last in MADE and (transition is not None or place is not None)
                if of_part and self._foreign:  # a plain net has these parts, and nothing that is expanded
                    of_part = bool((transition and transition.action) or (place and place.on_invalid))
                if of_part or (first in MADE_OF_SERVICES and last in net.services):
                    sentence = (
                        f"'{shown_name(name)}' is the name of a part that is made of '{first if of_part else last}'"
                    )
                    raise self._error((section, name), sentence, key=True)

    def _require_countable(self, net: Net) -> None:
        """Refuse to count tokens of commands that go together: arcs do not tell how many pairs they make."""
        counted = [t for t in net.transitions.values() if t.action is None and t.at_once > 1]
        if not counted or not (net.symbols() or net.services):
            return
        resources = resource_places(net)
        for transition in counted:
            if sum(weight for place, weight in transition.inputs.items() if place not in resources) > 1:
                sentence = "counts tokens with a delay, and takes several that may belong to commands; one is allowed"
                raise self._error(("transitions", transition.name, "servers"), sentence, key=True)

    def _with_otherwise(self, net: Net) -> Iterator[tuple[str, Transition]]:
        """Yield the transitions; a guard `otherwise` knows which guards it stands against."""
        resources = resource_places(net) if OTHERWISE in net.guards() else frozenset[str]()
        for name, transition in net.transitions.items():
            if transition.guard != Guard(OTHERWISE):
                yield name, transition
                continue
            places = transition.inputs.keys() - resources
            others = [t.guard for t in net.transitions.values() if t.guard is not None and places & t.inputs.keys()]
            against = [guard for guard in others if guard.name != OTHERWISE]
            if len(others) != len(against) + 1 or not against:
                sentence = "'otherwise' needs other guards at the same places, none of them 'otherwise'"
                raise self._error(("transitions", name, "guard"), sentence)
            yield name, replace(transition, guard=Guard(OTHERWISE, unless=tuple(sorted(against, key=str))))

    def _add_tries(self, places: dict[str, Place], transitions: dict[str, Transition]) -> None:
        """Write out the tries of transitions with several ones, each behind the first one."""
        written = dict(transitions)
        transitions.clear()
        for name, transition in written.items():
            count = self._file.transitions[name].tries
            more, made = written_out(transition, count, self._file.escalate)
            for kind, new, known in (("place", more, places), ("transition", made[1:], written)):
                for part in new:
                    if part.name in known:
                        sentence = f"makes a {kind} '{shown_name(part.name)}', and there is one of that name"
                        raise self._error(("transitions", name, "tries"), sentence)
            places.update((place.name, place) for place in more)
            transitions.update((each.name, each) for each in made)

    def _retried(self, location: Location, name: str | None) -> str | None:
        if name is not None and name not in self._file.transitions:
            sentence = f"there is no transition '{shown_name(name)}'{nearest(name, self._file.transitions)}"
            raise self._error(location, sentence)
        return name

    def _cancelled(self, location: Location, name: str | None) -> str | None:
        other = self._file.transitions.get(name or "")
        if name is not None and (other is None or _action(other) is None or other.tries > 1):
            acting = [each for each, file in self._file.transitions.items() if _action(file) is not None]
            sentence = "no transition with an action, tried once" if other is not None else "no transition"
            raise self._error(location, f"'{shown_name(name)}' is {sentence}{nearest(name, acting)}")
        return name

    def _require_one_reading(self, transitions: Mapping[str, Transition]) -> None:
        """Check whether all readers of a symbol agree on the reading."""
        first: dict[str, Transition] = {}
        for name, transition in transitions.items():
            if transition.symbol is not None:
                other = first.setdefault(transition.symbol, transition)
                if (other.symbol_of, other.symbol_expires) != (transition.symbol_of, transition.symbol_expires):
                    read, by = shown_name(transition.symbol), shown_name(other.name)
                    sentence = f"says of '{read}' something else than transition '{by}' does"
                    raise self._error(("transitions", name, "symbol"), sentence)

    def _require_arguments(self, places: Mapping[str, Place]) -> None:
        """Check whether the arguments in the names of data objects are declared."""
        declared = [each.arguments for each in self._file.commands.values()]
        declared += [each.arguments for each in self._file.services.values() if each.arguments is not None]
        known = dict.fromkeys(name for arguments in declared for name in arguments)
        for name, place in places.items():
            for argument in re.findall(r"\$\{([^}]*)\}?", place.data_object or ""):
                if argument.removeprefix("arguments.") not in known or not argument.startswith("arguments."):
                    options = [f"arguments.{each}" for each in known]
                    sentence = f"there is no '{argument}' that a name could say{nearest(argument, options)}"
                    raise self._error(("places", name, "data_object"), sentence)

    def _place(self, name: str, file: PlaceFile) -> Place:
        for rank, other in enumerate(file.on_invalid):
            self._known(("places", name, "on_invalid", rank), other)
        bounds = (file.tokens, file.capacity)
        place = Place(name, *bounds, None, file.on_invalid, file.remote, file.resource, title=file.title)
        if (thing := file.data_object) is None:
            return place
        scope = ObjectScope(thing.scope)
        return replace(place, data_object=thing.name, object_type=thing.type, object_scope=scope)

    def _commands(self, transitions: Mapping[str, Transition]) -> dict[str, CommandDeclaration]:
        begun = {t.symbol for t in transitions.values() if t.symbol is not None and t.symbol_of is None}
        commands = {}
        for symbol, command in self._file.commands.items():
            here: Location = ("commands", symbol)
            if symbol not in begun:
                hint = nearest(symbol, begun)
                sentence = f"no transition begins a command with the symbol '{shown_name(symbol)}'{hint}"
                raise self._error(here, sentence, key=True)
            schema = self._schema((*here, "arguments"), command.arguments)
            busy = Busy(command.busy)
            commands[symbol] = CommandDeclaration(command.description, schema, command.needs, busy, command.priority)
        return commands

    def _schema(self, location: Location, file: Mapping[str, ArgumentFile]) -> ArgumentSchema:
        return ArgumentSchema({name: self._argument((*location, name), name, each) for name, each in file.items()})

    def _argument(self, location: Location, name: str, file: ArgumentFile) -> Argument:
        bare = Argument(name, ArgumentType(file.type).element)
        for rank, choice in enumerate(file.choices):
            self._fits(bare, choice, (*location, "choices", rank))
        argument = file.argument(name)
        if not argument.required:
            self._fits(argument, file.default, (*location, "default"))
        return argument

    def _fits(self, argument: Argument, value: object, location: Location) -> None:
        try:
            argument.check(value)
        except DataError as error:
            raise self._error(location, error.message) from error

    def _transition(self, name: str, file: TransitionFile) -> Transition:
        here: Location = ("transitions", name)
        inputs = self._local((*here, "in"), file.inputs)
        outputs, remote_outputs = self._arcs((*here, "out"), file.outputs)
        on_failure = self._local((*here, "on_failure"), file.on_failure)
        inhibitors = self._local((*here, "inhibitors"), file.inhibitors)
        for target in remote_outputs:
            if target.net == self._file.net:
                sentence = f"'{target}' is a place of this very net; write '{target.place}'"
                raise self._error((*here, "out"), sentence)
        action = _action(file)
        if action is not None and not on_failure and self._file.escalate is None:
            sentence = f"{action} can fail: say where the tokens go with 'on_failure', or give the net 'escalate'"
            raise self._error(here, sentence)
        if not self._foreign:  # nets of other tools may be dead or fire without end; verification says so
            if not inputs and file.symbol is None:
                raise self._error(here, "has neither input places nor a symbol, and would fire without end")
            for place in inputs.keys() & inhibitors.keys():
                if inhibitors[place] <= inputs[place]:
                    sentence = f"'{place}' both enables and disables it; it could never fire"
                    raise self._error((*here, "inhibitors"), sentence)
        strategy, symbol = file.strategy, file.symbol
        if file.servers is not None:
            self._check_servers((*here, "servers"), file, action)
        return Transition(
            name,
            inputs,
            outputs,
            remote_outputs,
            inhibitors,
            None if file.guard is None else Guard.of(file.guard),
            None if symbol is None else symbol.name,
            file.emit,
            action,
            on_failure,
            self._local((*here, "on_doubt"), file.on_doubt),
            timeout=file.timeout,
            delay=None if file.delay is None else self._delay((*here, "delay"), file.delay),
            success=file.success,
            weight=file.weight,
            strategy=None if strategy is None else Strategy(**strategy.model_dump()),
            priority=file.priority,
            symbol_of=None if symbol is None or symbol.of is None else ReadFor(symbol.of),
            symbol_expires=None if symbol is None else symbol.expires,
            retry_of=self._retried((*here, "retry_of"), file.retry_of),
            origin=name,
            line=self._keys[name].line,
            file="" if self._keys[name].file == self._root.file else self._keys[name].file,
            result=file.result,
            store=file.store,
            marks=_marks(find(self._root, here).value),
            acts_on=file.acts_on,
            resets=self._resets((*here, "resets"), file.resets),
            title=file.title,
            says=file.says,
            servers=file.servers,
            keeps_failure=file.keeps_failure,
            cancels=self._cancelled((*here, "cancels"), file.cancels),
        )

    def _check_servers(self, location: Location, file: TransitionFile, action: Action | None) -> None:
        """Refuse servers that nothing could count."""
        if action is not None:
            if file.tries > 1:
                sentence = "counts tokens of one try, and 'tries' makes several transitions; one of both is allowed"
                raise self._error(location, sentence, key=True)
        elif file.servers != 1:
            other = next((key for key in ("guard", "symbol") if getattr(file, key) is not None), None)
            if other is not None:
                sentence = f"counts tokens with a delay, and '{other}' lets not all wait; one of both is allowed"
                raise self._error(location, sentence, key=True)
            if not file.inputs:
                raise self._error(location, "counts input tokens with a delay, and there is no 'in'", key=True)

    def _resets(self, location: Location, names: tuple[str, ...]) -> tuple[str, ...]:
        """Check the emptied places of a transition: free tokens, and a bound."""
        ways = 1
        for rank, name in enumerate(names):
            at: Location = (*location, rank)
            self._known(at, name)
            place = self._file.places[name]
            if not place.resource or place.remote:
                sentence = "may hold what belongs to a command; it must be `resource: true`, and not `remote`"
                raise self._error(at, f"'{shown_name(name)}' {sentence}")
            if place.capacity is None:
                sentence = "must have a `capacity`: of places without bound it is undecidable what they reach"
                raise self._error(at, f"'{shown_name(name)}' {sentence}")
            ways *= place.capacity + 1
        if len(set(names)) < len(names):
            raise self._error(location, "names a place twice")
        if ways > MOST_WAYS:
            sentence = f"these places can hold tokens in {ways} ways together; at most {MOST_WAYS} can be verified"
            raise self._error(location, sentence)
        return names

    def _arcs(self, location: Location, arcs: Mapping[str, int]) -> tuple[dict[str, int], dict[RemotePlace, int]]:
        """Separate places of the net from places of other nets, marked by a dot in the name."""
        local: dict[str, int] = {}
        remote: dict[RemotePlace, int] = {}
        for name, weight in arcs.items():
            if name in self._file.places:
                local[name] = weight
                continue
            net, dot, place = name.partition(".")
            if not dot or not is_name(net) or not is_qualified(place):
                written = find(self._root, location).value
                rank = next((rank for rank, child in enumerate(written.children) if child.text == name), None)
                at: Location = (*location, name if rank is None else rank)
                raise self._error(at, self._no_place(name), key=written.kind is Kind.MAPPING)
            remote[RemotePlace(net, place)] = weight
        return local, remote

    def _local(self, location: Location, arcs: Mapping[str, int]) -> dict[str, int]:
        local, remote = self._arcs(location, arcs)
        for target in remote:
            raise self._error(location, f"'{target}' is a place of another net; only 'out' may name one")
        return local

    def _delay(self, location: Location, file: DelayFile) -> Delay:
        ((kind, distribution),) = ((key, getattr(file, key)) for key in file.model_fields_set)
        values = dict(distribution)
        if kind == "exponential":
            values = {"rate": values["rate"] if values["mean"] is None else 1.0 / values["mean"]}
        try:
            return Delay(kind, tuple(values.values()))
        except NetError as error:
            raise self._error((*location, kind), error.message) from error

    def _known(self, location: Location, name: str) -> None:
        if name not in self._file.places:
            raise self._error(location, self._no_place(name))

    def _no_place(self, name: str) -> str:
        return f"there is no place '{shown_name(name)}'{nearest(name, self._file.places)}"

    def _require_names(self, net: Net) -> None:
        """Check whether a name of another tool collides with a name of the expansion."""
        ours = net.services or any(place.on_invalid or place.remote for place in net.places.values())
        if not ours and not any(t.action or t.remote_outputs for t in net.transitions.values()):
            return
        sections: Iterable[tuple[str, Iterable[str]]] = (("places", net.places), ("transitions", net.transitions))
        for section, names in sections:
            for name in names:
                if not is_qualified(name) or name in (INPUT_SEMAPHORE, OUTPUT_SEMAPHORE):
                    sentence = f"'{shown_name(name)}' is not a name that a net with actions or services can have"
                    raise self._error((section, name), sentence, key=True)

    def _error(self, location: Location, sentence: str, *, key: bool = False) -> NetFileError:
        return complaint_at(self._root, location, sentence, key=key)


def _assumption(file: AssumptionFile) -> Assumption:
    if file.returns is None:
        return Assumption(at_most=file.at_most)
    net, _, place = file.returns.partition(".")
    return Assumption(returns=RemotePlace(net, place))


def _action(file: TransitionFile) -> Action | None:
    if file.action is not None:
        return FunctionAction(file.action)
    if (call := file.service) is not None:
        return ServiceAction(call.name, call.type, call.request, call.build, call.handle, call.task)
    if (goal := file.goal) is not None:
        return GoalAction(goal.name, goal.type, goal.goal, goal.build, goal.handle, goal.task)
    if (topic := file.topic) is not None:
        return TopicAction(topic.name, topic.type, topic.message, topic.build)
    if (awaited := file.awaited) is not None:
        return AwaitAction(awaited.name, awaited.type, awaited.latched, awaited.handle, awaited.until, awaited.silent)
    if (request := file.request) is not None:
        net, _, service = request.to.partition(".")
        return RequestAction(net, service, request.arguments, request.build)
    return ValuesAction() if file.result or file.store else None


_VALUES = ("guard", "service", "goal", "topic", "await", "request", "says", "result", "store", "strategy")
"""Keys of a transition under which values stand."""


def _marks(written: Value) -> dict[Location, Mark]:
    """Return the places of the values of a transition."""
    marks: dict[Location, Mark] = {}

    def enter(location: Location, key: Value, value: Value) -> None:
        place = value if value.kind is Kind.SCALAR and not value.is_null else key
        marks[location] = Mark(place.file, place.line, place.column, place.note)
        for name, child in value.pairs:
            enter((*location, name.text), name, child)
        for rank, child in enumerate(value.children):
            enter((*location, rank), child, child)

    for key, value in written.pairs:
        if key.text in _VALUES:
            enter((key.text,), key, value)
    return marks
