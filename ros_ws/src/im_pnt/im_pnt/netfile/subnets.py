"""Subnets of a net file: templates with ports, used as transitions, or as scopes around transitions.

A use is a substitution transition (Jensen, "Coloured Petri Nets", 1992): a port, a place of the subnet, is one with a
place at the use. All else of the subnet (places, transitions, data objects) has the name of the use and a dot before
its own name, so the net is flat when it is read, and is verified, run and recorded as any other.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from im_core.errors import DataError, nearest, quoted_text
from im_core.text.yamltext import MAX_VALUES, Kind, Value, as_data, find, mapping, plain_scalar, scalar, sequence
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import as_text
from im_pnt.expression.syntax import Binary, Field, Listing, Literal, Name, Node, Unary, parse, rebuilt, shown
from im_pnt.expression.template import OPENS, has_expressions, written_pieces
from im_pnt.netfile.interrupts import Interrupt, Weave
from im_pnt.netfile.schema.names import is_qualified
from im_pnt.netfile.schema.scalars import as_plain, written
from im_pnt.netfile.schema.templates import Parameter, PortsFile, SubnetUseFile, as_parameter
from im_pnt.netfile.schema.transitions import ACTIONS
from im_pnt.netfile.substitution import Template, filled, size
from im_pnt.netfile.text import checked, complaint, complaint_at, read_data

Pair = tuple[Value, Value]
_ARCS = ("in", "out", "inhibitors", "resets", "on_failure", "on_doubt")
_TAKEN = ("in", "inhibitors", "resets")
_KINDS = ("in", "out", "on_failure")
_SCOPE = (3, 2, 1)
"""Ports of a scope in ``in``, ``out`` and ``on_failure``."""


@dataclass(slots=True)
class _Level:
    """Names of a subnet in use, or of the net itself.

    Attributes:
        prefix: What stands before its names; empty: it is the net itself.
        places: Its places and ports, with the names in the whole net.
        only_given: Its ports that it gives tokens to, and takes none from.
        transitions: Its transitions.
        objects: Its data objects, with the names in the whole net.
        arguments: What its use gives, in words of the whole net.
        results: Results of its uses, by use.
        chain: Templates that it is within.
    """

    prefix: str = ""
    places: dict[str, str] = field(default_factory=dict)
    only_given: frozenset[str] = frozenset()
    transitions: frozenset[str] = frozenset()
    objects: Mapping[str, str] = field(default_factory=dict)
    arguments: Mapping[str, Value] = field(default_factory=dict)
    results: dict[str, Mapping[str, Node]] = field(default_factory=dict)
    chain: tuple[str, ...] = ()

    def place(self, name: Value, *, port: bool = False) -> Value:
        """Return a name of a place, as in the whole net; other nets' places stay, but where a port is asked for."""
        if name.text in self.places:
            return replace(name, text=self.places[name.text])
        if port or (self.prefix and "." not in name.text):
            raise complaint(name, f"there is no place {quoted_text(name.text)}{nearest(name.text, self.places)}")
        return name

    def arcs(self, key: str, value: Value) -> Value:
        """Return the arcs of a transition, or the places of another list."""
        if value.kind is Kind.MAPPING:
            return replace(value, pairs=tuple((self.arcs(key, name), weight) for name, weight in value.pairs))
        if value.kind is Kind.LIST:
            return replace(value, children=tuple(self.arcs(key, child) for child in value.children))
        if value.is_null:
            return value
        if key in _TAKEN and value.text in self.only_given:
            raise complaint(
                value, f"{quoted_text(value.text)} is a port that the subnet gives tokens to, and takes none from"
            )
        return self.place(value)

    def object(self, value: Value) -> Value:
        """Return a data object of a place: its name, or its keys."""
        if value.kind is Kind.MAPPING:
            keys = {key.text: child for key, child in value.pairs}
            if "scope" in keys and keys["scope"].text == "global":
                return self.values(value)
            pairs = ((key, self.object(child) if key.text == "name" else child) for key, child in value.pairs)
            return replace(value, pairs=tuple(pairs))
        return self.values(replace(value, text=self.objects.get(value.text, value.text)))

    def values(self, value: Value, *, guard: bool = False) -> Value:
        """Return a value with the expressions in words of the whole net."""
        if value.kind is Kind.LIST:
            return replace(value, children=tuple(self.values(child) for child in value.children))
        if value.kind is Kind.MAPPING:
            return replace(value, pairs=tuple((key, self.values(child)) for key, child in value.pairs))
        if OPENS not in value.text or not (self.prefix or self.results):
            return value
        try:
            parts = written_pieces(value.text)
            done: list[str] = []
            for part in parts:
                node = parse(part[2:-1]) if part.startswith(OPENS) else None
                if node is None:
                    done.append(part)
                    continue
                match node:
                    case Field(Name("arguments"), name) if self.prefix and len(parts) == 1 and not guard:
                        return self._given(name)  # keeps its type
                other = self._node(node)
                if other == node:
                    done.append(part)
                elif isinstance(other, Literal) and not guard:
                    done.append(as_text(other.value))
                else:
                    text = shown(other)
                    done.append(f"{OPENS}{text[1:-1] if isinstance(other, Unary | Binary) else text}}}")
        except ExpressionError as error:
            raise complaint(value, str(error)) from error
        return replace(value, text="".join(done), quoted=True)

    def _given(self, name: str) -> Value:
        if name not in self.arguments:
            hint = nearest(name, self.arguments) or "; it takes none"
            raise ExpressionError(f"arguments.{name}: the subnet has no such argument{hint}")
        return self.arguments[name]

    def _node(self, node: Node) -> Node:
        """Return an expression in words of the whole net."""
        match node:
            case Field(Name("arguments"), name) if self.prefix:
                return _expression(self._given(name), name)
            case Field(Field(Name("answers"), use), name) if use in self.results:
                if name not in self.results[use]:
                    raise ExpressionError(f"answers.{use} has no result '{name}'{nearest(name, self.results[use])}")
                return self.results[use][name]
            case Field(Name("answers"), name) if self.prefix:
                if name not in self.transitions:
                    hint = nearest(name, self.transitions)
                    raise ExpressionError(f"answers.{name}: there is no transition '{name}' in the subnet{hint}")
                return Field(Name("answers"), self.prefix + name)
            case Field(Name("data"), name) if self.prefix:
                if name not in self.objects:
                    hint = nearest(name, self.objects)
                    raise ExpressionError(f"data.{name}: there is no data object '{name}' in the subnet{hint}")
                return Field(Name("data"), self.objects[name])
        return rebuilt(node, self._node)


def _parameter(value: Value) -> Parameter:
    """Return a given value as that of a parameter.

    Raises:
        NetFileError: It is nothing, or a number that is not finite.
    """
    try:
        return as_parameter(as_data(value, written))
    except ValueError as error:
        raise complaint(value, str(error)) from error


def _expression(value: Value, name: str) -> Node:
    """Return a given value as an expression.

    Raises:
        ExpressionError: There is none for it.
    """
    if value.kind is Kind.LIST:
        return Listing(tuple(_expression(child, name) for child in value.children))
    if value.kind is Kind.SCALAR and OPENS in value.text:
        (first, *more) = written_pieces(value.text)
        if not more and first.startswith(OPENS):
            return parse(first[2:-1])
    elif value.kind is Kind.SCALAR:
        data = plain_scalar(value)
        if isinstance(data, bool | int | float) or (isinstance(data, str) and "'" not in data):
            return Literal(data)
    raise ExpressionError(f"arguments.{name} is {value.shown()}, which cannot be part of an expression")


class Subnets:
    """Uses of subnets in a net, replaced by the parts of the subnets."""

    def __init__(self, templates: Mapping[str, Template], interrupts: Sequence[Interrupt] = ()) -> None:
        self._templates = templates
        self._interrupts: dict[str, list[Interrupt]] = {}
        for interrupt in interrupts:
            for name in interrupt.file.during:
                self._interrupts.setdefault(name, []).append(interrupt)
        self._places: list[Pair] = []
        self._rest: list[Value] = []
        self._values = 0

    def replaced(
        self, sections: Mapping[str, list[Pair]], rest: list[Value] | None
    ) -> tuple[dict[str, list[Pair]], list[Value] | None]:
        """Return the sections and ``rest`` of a net without uses of subnets.

        Raises:
            NetFileError: A use does not fit the subnet, or a subnet is wrong.
        """
        net = _Level(places={name.text: name.text for name, _ in sections.get("places", ())})
        known = [key.text for key, _ in sections.get("transitions", ())]
        for name, (interrupt, *_) in self._interrupts.items():
            if name not in known:
                sentence = f"there is no transition {quoted_text(name)}{nearest(name, known)}"
                raise complaint_at(interrupt.written, ("during",), sentence)
        transitions = list(self._transitions(net, sections.get("transitions", [])))
        places = [*sections.get("places", []), *self._places]
        all_rest = [*(rest or []), *self._rest] if rest is not None or self._rest else None
        return {**sections, "places": places, "transitions": transitions}, all_rest

    def _transitions(self, level: _Level, pairs: list[Pair]) -> Iterator[Pair]:
        """Yield the transitions of a level; the uses are replaced first, for their results are in words of others."""
        done: dict[int, list[Pair]] = {}
        for rank, (key, value) in enumerate(pairs):
            if "use" in _keys(value):
                done[rank] = list(self._transition(level, key, value))
        for rank, (key, value) in enumerate(pairs):
            yield from done[rank] if rank in done else self._transition(level, key, value)

    def _transition(self, level: _Level, key: Value, value: Value) -> Iterator[Pair]:
        keys = _keys(value)
        if "with" in keys:
            yield from self._scoped(level, key, value)
        elif not level.prefix and key.text in self._interrupts:
            yield from self._interrupted(level, key, value)
        elif "use" in keys:
            yield from self._used(level, key, value)
        else:
            yield replace(key, text=level.prefix + key.text), _content(level, value)

    def _used(self, level: _Level, key: Value, value: Value) -> Iterator[Pair]:
        """Yield the transitions of a subnet in use."""
        if not is_qualified(key.text):
            raise complaint(key, f"{quoted_text(key.text)} is not a name that a use of a subnet can have")
        use = checked(value, read_data(value), SubnetUseFile, SubnetUseFile.model_validate)
        if use.use not in self._templates:
            hint = nearest(use.use, self._templates) or "; there is none in the net or what it includes"
            raise complaint_at(value, ("use",), f"there is no template {quoted_text(use.use)}{hint}")
        template = self._templates[use.use]
        if use.use in level.chain:
            raise complaint_at(value, ("use",), f"uses go round: {' -> '.join([*level.chain, use.use])}")
        if template.file.ports is None:
            raise complaint_at(value, ("use",), f"template {use.use} has no ports: it is copied by 'use' of the net")
        prefix = f"{level.prefix}{key.text}."
        note = f" (subnet {use.use}, used in {key.file}:{key.line}:{key.column})"
        given = self._given(level, value, use, template)
        bound = dict(template.given)
        bound |= {name: _parameter(child) for name, child in given.items() if name in template.file.parameters}
        raw = find(template.root, template.location).value
        objects = {name: prefix + name for name in _objects(raw)}
        sections = {k.text: filled(template.location, v, {**bound, **objects}, note) for k, v in raw.pairs}
        ports = self._ports(level, value, use, template)
        pairs = {name: list(sections[name].pairs) if name in sections else [] for name in ("places", "transitions")}
        for name, _ in pairs["places"]:
            if name.text in ports:
                raise complaint(name, f"{quoted_text(name.text)} is a port, which the place at each use is")
        inner = _Level(
            prefix,
            {**ports, **{name.text: prefix + name.text for name, _ in pairs["places"]}},
            frozenset(name for name in ports if name not in template.file.ports.inputs),
            frozenset(name.text for name, _ in pairs["transitions"]),
            objects,
            {name: child for name, child in given.items() if name in template.file.arguments},
            chain=(*level.chain, use.use),
        )
        self._values += sum(map(size, sections.values()))
        if self._values > MAX_VALUES:
            raise complaint(key, f"the uses of subnets make more than {MAX_VALUES} values")
        for name, child in pairs["places"]:
            self._places.append((replace(name, text=prefix + name.text), _content(inner, child)))
        if "rest" in sections:
            listed = inner.arcs("rest", sections["rest"])
            self._rest += listed.children if listed.kind is Kind.LIST else [listed]
        for name, child in self._transitions(inner, pairs["transitions"]):
            yield name, _keeping_failure(child, key) if use.keeps_failure else child
        results = {}
        for name, child in sections["results"].pairs if "results" in sections else ():
            try:
                results[name.text] = _expression(inner.values(child), name.text)
            except ExpressionError as error:
                raise complaint(child, str(error)) from error
        level.results[key.text] = results

    def _given(self, level: _Level, value: Value, use: SubnetUseFile, template: Template) -> dict[str, Value]:
        """Return the values of arguments and parameters that a use gives, in words of the whole net."""
        declared = {**template.file.arguments, **dict.fromkeys(template.file.parameters)}
        written_ones = {key.text: (key, child) for key, child in find(value, ("arguments",)).value.pairs}
        given: dict[str, Value] = {}
        for name, (key, child) in written_ones.items() if use.arguments else ():
            if name not in declared:
                hint = nearest(name, declared) or "; it takes none"
                raise complaint(key, f"subnet {use.use} has no argument {quoted_text(name)}{hint}")
            given[name] = level.values(child)
        for name, file in declared.items():
            if name not in given:
                if file is None or "default" not in file.model_fields_set:
                    raise complaint_at(value, ("use",), f"subnet {use.use} needs its argument '{name}'")
                given[name] = find(template.root, (*template.location, "arguments", name, "default")).value
            data = as_plain(as_data(given[name], written))
            if file is not None and not has_expressions(data):
                try:
                    file.argument(name).check(data)
                except DataError as error:
                    raise complaint(given[name], error.message) from error
        return given

    def _ports(self, level: _Level, value: Value, use: SubnetUseFile, template: Template) -> dict[str, str]:
        """Return the places of the whole net that the ports are one with."""
        ports = template.file.ports or PortsFile()
        bound: dict[str, str] = {}
        for kind, names, given in zip(
            _KINDS,
            (ports.inputs, ports.outputs, ports.on_failure),
            (use.inputs, use.outputs, use.on_failure),
            strict=True,
        ):
            if len(names) != len(given):
                sentence = f"subnet {use.use} has {len(names)} ports here ({', '.join(names)}), not {len(given)}"
                raise complaint_at(value, (kind,), sentence, key=True)
            for rank, name in enumerate(names):
                place = level.place(find(value, (kind, rank)).value, port=True)
                if bound.setdefault(name, place.text) != place.text:
                    sentence = (
                        f"port {name} of subnet {use.use} is {bound[name]} and {place.text}, which must be one place"
                    )
                    raise complaint(place, sentence)
        return bound

    def _scoped(self, level: _Level, key: Value, value: Value) -> Iterator[Pair]:
        """Yield the transitions of scopes around a transition, from the outermost inward, then the transition."""
        arcs = _single_arcs(key, value, "a scope")
        scopes = next(child for k, child in value.pairs if k.text == "with")
        entries = scopes.pairs or tuple((each, mapping((), each)) for each in scopes.children or (scopes,))
        for scope, arguments in entries:
            template = self._templates.get(scope.text)
            ports = None if template is None else template.file.ports
            if ports is None or (len(ports.inputs), len(ports.outputs), len(ports.on_failure)) != _SCOPE:
                hint = "" if template is not None else nearest(scope.text, self._templates)
                sentence = "a scope is a template with three ports in 'in', two in 'out' and one in 'on_failure'"
                raise complaint(scope, f"{quoted_text(scope.text)} is no scope: {sentence}{hint}")
            _, over, leaving = ports.inputs
            inner = {"in": ports.outputs[0], "out": over, "on_failure": leaving}
            places = {kind: scalar(f"{key.text}.{scope.text}_{name}", key) for kind, name in inner.items()}
            for place in places.values():
                full = level.prefix + place.text
                level.places[place.text] = full
                self._places.append((replace(place, text=full), scalar("", place, quoted=False)))
            around = {
                "use": scope,
                "in": sequence((arcs["in"], places["out"], places["on_failure"]), scope),
                "out": sequence((places["in"], arcs["out"]), scope),
                "on_failure": arcs["on_failure"],
                "arguments": arguments,
            }
            name = scalar(f"{key.text}.{scope.text}", scope)
            yield from self._used(level, name, mapping(((scalar(k, scope), v) for k, v in around.items()), scope))
            level = replace(level, results={**level.results, scope.text: level.results[name.text]})  # inside of it
            arcs = places
        pairs = ((k, arcs.get(k.text, child)) for k, child in value.pairs if k.text != "with")
        yield from self._transition(level, key, mapping(pairs, value))

    def _interrupted(self, level: _Level, key: Value, value: Value) -> Iterator[Pair]:
        """Yield a transition, or the subnet that it stands for, with its interrupts; the first one is the outermost."""
        arcs: Mapping[str, Value] = _single_arcs(key, value, "an interrupt")
        for k, _ in value.pairs:
            if k.text in ("tries", "on_doubt"):
                raise complaint(k, f"'{k.text}' does not go together with an interrupt of {key.text}")
        weaves = []
        for interrupt in self._interrupts.pop(key.text):
            weaves.append(Weave(interrupt, key.text, arcs))
            arcs = weaves[-1].inner
            for name in weaves[-1].places:
                level.places[name] = name
                self._places.append((scalar(name, interrupt.written), scalar("", key, quoted=False)))
        inner = ((k, arcs.get(k.text, child)) for k, child in value.pairs)
        made = list(self._transition(level, key, mapping(inner, value)))
        acting = [name.text for name, content in made if _keys(content) & {*ACTIONS, "result", "store"}]
        if not acting:
            raise complaint(key, f"transition {key.text} has no action that an interrupt could end")
        for weave in weaves:
            for each, content in weave.transitions(acting):
                yield from self._transition(level, each, content)
        yield from made


def _single_arcs(key: Value, value: Value, what: str) -> dict[str, Value]:
    """Return the only place in each of the arcs of a transition, by the keys; of no other kind may it have any."""
    arcs = {kind: find(value, (kind, 0)).value for kind in _KINDS if kind in _keys(value)}
    for other, _ in value.pairs:
        if other.text in ("guard", "symbol", "inhibitors", "resets", "emit"):
            raise complaint(other, f"'{other.text}' does not go together with {what}; give it a transition of its own")
    for kind in _KINDS:
        count = len(find(value, (kind,)).value.children) if kind in arcs else 0
        if kind not in arcs or count > 1 or arcs[kind].kind is not Kind.SCALAR:
            raise complaint(key, f"a transition with {what} needs one place in each of {', '.join(_KINDS)}")
    return arcs


def _keys(value: Value) -> set[str]:
    return {key.text for key, _ in value.pairs}


def uses_subnets(root: Value) -> bool:
    """Whether a transition of a file uses a subnet or a scope."""
    transitions = find(root, ("transitions",))
    return transitions.key is not None and any({"use", "with"} & _keys(value) for _, value in transitions.value.pairs)


def _keeping_failure(transition: Value, near: Value) -> Value:
    """Return a transition that keeps failures."""
    key = "keeps_failure"
    pairs = [pair for pair in transition.pairs if pair[0].text != key]
    return mapping([*pairs, (scalar(key, near), scalar("true", near, quoted=False))], transition)


def _objects(template: Value) -> list[str]:
    """Return the data objects of a subnet that each use has for itself."""
    names: list[str] = []
    for _, place in find(template, ("places",)).value.pairs:
        thing = next((child for key, child in place.pairs if key.text == "data_object"), None)
        keys = {} if thing is None else {key.text: child.text for key, child in thing.pairs}
        if thing is not None and keys.get("scope") != "global":
            names.append(keys.get("name", thing.text))
    return list(dict.fromkeys(names))


def _content(level: _Level, value: Value) -> Value:
    """Return a place or a transition in words of the whole net."""
    pairs: list[Pair] = []
    for key, child in value.pairs:
        if key.text in _ARCS or key.text == "on_invalid":
            child = level.arcs(key.text, child)
        elif key.text == "data_object":
            child = level.object(child)
        elif key.text == "store":
            named = ((replace(k, text=level.objects.get(k.text, k.text)), level.values(v)) for k, v in child.pairs)
            child = replace(child, pairs=tuple(named))
        elif key.text in ("retry_of", "cancels") and child.text in level.transitions:
            child = replace(child, text=level.prefix + child.text)
        else:
            child = level.values(child, guard=key.text == "guard")
        pairs.append((key, child))
    return replace(value, pairs=tuple(pairs)) if pairs else value
