"""Scenario files: models, and the check against the nets."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import pydantic
from pydantic import AfterValidator, BeforeValidator, Field

from im_core.config import FieldError, Model, fault_in, load_model
from im_core.errors import ConfigError, ImError, nearest
from im_core.files import read_text
from im_core.text.yamltext import Location, find, read_yaml
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.inference import Meanings
from im_pnt.expression.scope import ANSWERED, SENT, NetScope, PlacedError, check_value
from im_pnt.expression.template import has_expressions
from im_pnt.expression.types import ValueType, installed_types, message_type
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction
from im_pnt.model.net import Net
from im_pnt.netfile import load_net

SUFFIX = ".test.yml"
"""End of the names of scenario files: ``nets/*.yaml`` are nets and nothing else."""

MARKS = "+!~?"
"""Marks behind a transition in ``order`` and ``never``: begun, failed, cancelled, in doubt; without one: ended well."""

_LARGEST = 4 * 1024 * 1024
_KINDS = ("symbol", "request", "cancel", "guards", "objects", "messages")


def _as_list(value: object) -> object:
    return value if isinstance(value, list) else [value]


def _as_times(value: object) -> object:
    return value if isinstance(value, list) else [value, value]


def _in_order(times: tuple[float, float]) -> tuple[float, float]:
    if times[0] > times[1]:
        raise ValueError(f"the least time, {times[0]:g} s, is greater than the greatest, {times[1]:g} s")
    return times


Seconds = Annotated[float, Field(ge=0.0)]
Fields = dict[str, object]
Times = Annotated[tuple[Seconds, Seconds], BeforeValidator(_as_times), AfterValidator(_in_order)]
Ends = Literal["done", "failed", "cancelled", "open", "waiting"]


class AnswerFile(Model):
    """Mocked answer to an action.

    Attributes:
        answer: Fields of the answer; of a function, the results that it leaves. Fields that are left out are empty.
        when: Fields of the request for which it is given; others take the answers without ``when``, in order.
        after: Time that the action takes [s]; None: the mean of the transition's ``delay``.
        failure: Reason of a failure; None: it does not fail.
        code: Code of the failure.
        doubt: Why nobody knows what became of it; None: it is known.
        silent: Whether no answer ever comes.
    """

    answer: Fields = Field({})
    when: Fields = Field({})
    after: Seconds | None = None
    failure: str | None = None
    code: str = "failed"
    doubt: str | None = None
    silent: bool = False

    @pydantic.model_validator(mode="after")
    def _one_end(self) -> Self:
        if sum((bool(self.answer), self.failure is not None, self.doubt is not None, self.silent)) > 1:
            raise ValueError("an action ends in one way: answer, failure, doubt or silent")
        if "code" in self.model_fields_set and self.failure is None and self.answer.get("success") is not False:
            raise FieldError(("code",), "is of a failure; give `failure`, or an answer with `success: false`")
        return self


Answers = dict[str, Annotated[tuple[AnswerFile, ...], BeforeValidator(_as_list), Field(min_length=1)]]
Guards = dict[str, Annotated[tuple[bool, ...], BeforeValidator(_as_list), Field(min_length=1)]]
Objects = dict[str, Fields]


class StepFile(Model):
    """One step from outside, one of :data:`_KINDS`; of a command or request also the expected end.

    Attributes:
        at: When [s]: since the begin, or since the begin of the action of ``while``.
        during: Transition whose first action it waits for, written ``while``.
        symbol: Symbol on the tape.
        request: Service that is requested, ``net.service``.
        arguments: Arguments of either.
        cancel: Symbol or ``net.service`` whose last command or request is cancelled.
        guards: Answers of guards from then on.
        objects: Data objects from then on.
        messages: Messages that are published, by topic; where a scenario has any of a topic, awaits hear these alone.
        ends: How the command or request ends, ``waiting`` where no transition has taken it; None: ``done``, with drawn
            answers in any way, or waiting.
        reason: Part of the reason of a failure.
        results: Results, at least these.
        takes: Least and greatest time until it ends [s]; a number is both.
    """

    at: Seconds = 0.0
    during: str | None = Field(None, alias="while")
    symbol: str | None = None
    request: str | None = None
    arguments: Fields = Field({})
    cancel: str | None = None
    guards: Guards = Field({})
    objects: Objects = Field({})
    messages: Objects = Field({})
    ends: Ends | None = None
    reason: str | None = None
    results: Fields = Field({})
    takes: Times | None = None

    @pydantic.model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = [kind for kind in _KINDS if getattr(self, kind)]
        if len(given) != 1:
            raise ValueError(f"a step is one of {', '.join(_KINDS)}; it is {' and '.join(given) or 'none'}")
        for key in ("arguments", "ends", "reason", "results", "takes"):
            if key in self.model_fields_set and given[0] not in ("symbol", "request"):
                raise FieldError((key,), f"is of a symbol or request, not of {given[0]}")
        return self


class ExpectationFile(Model):
    """Expectations of a whole run.

    Attributes:
        order: Firings that come in this order, others between: ``t``, or ``t`` with one of :data:`MARKS`.
        never: Firings that do not come.
        marking: Tokens of places at the end.
        time: Least and greatest time of the end [s]; a number is both.
        rest: Whether the nets are at rest at the end: no open command, no token where none may stay.
    """

    order: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    marking: dict[str, Annotated[int, Field(ge=0)]] = Field({})
    time: Times | None = None
    rest: bool = True


class ScenarioFile(Model):
    """One scenario.

    Attributes:
        steps: What comes from outside.
        answers: Answers of actions by transition: one, or several in order, of which the last stays.
        guards: Answers of registered guards: one, or several, a new one where the net has fired in between.
        objects: Data objects by name.
        until: Time of the end [s]; None: when all commands have ended and no action runs.
        random: Runs with drawn answers, arguments and cancellations, where none are written; None: none are drawn.
        expect: What is expected.
    """

    steps: tuple[StepFile, ...] = ()
    answers: Answers = Field({})
    guards: Guards = Field({})
    objects: Objects = Field({})
    until: Seconds | None = None
    random: Annotated[int, Field(ge=1, le=100_000)] | None = None
    expect: ExpectationFile = ExpectationFile()


class ScenariosFile(Model):
    """Scenarios of some nets.

    Attributes:
        nets: Net files, relative to this one; none: the net of the same name beside it.
        answers: Answers in all scenarios that say nothing else.
        scenarios: The scenarios by name.
    """

    nets: tuple[str, ...] = ()
    answers: Answers = Field({})
    scenarios: Annotated[dict[str, ScenarioFile], Field(min_length=1)]


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scenario, with the common parts of its file."""

    name: str
    line: int
    content: ScenarioFile


@dataclass(frozen=True, slots=True)
class ScenarioSet:
    """The scenarios of a file."""

    path: Path
    nets: tuple[Net, ...]
    scenarios: tuple[Scenario, ...]


def load_scenarios(path: Path) -> ScenarioSet:
    """Read a scenario file and its nets.

    Raises:
        ConfigError: It is no scenario file, or names what its nets do not have; names file, line and what is allowed.
        NetFileError: A net file is wrong.
    """
    file = load_model(path, ScenariosFile)
    names = file.nets or (f"{path.name.removesuffix(SUFFIX)}.yaml",)
    nets = tuple(load_net(path.parent / name) for name in names)
    root = read_yaml(read_text(path, _LARGEST), str(path))
    _Names(path, nets).check(file)
    scenarios = []
    for name, own in file.scenarios.items():
        key = find(root, ("scenarios", name)).key
        content = own.model_copy(update={"answers": {**file.answers, **own.answers}})
        scenarios.append(Scenario(name, key.line if key else 1, content))
    return ScenarioSet(path, nets, tuple(scenarios))


def awaits(nets: Iterable[Net]) -> Iterator[AwaitAction]:
    """Yield the awaits of nets."""
    for net in nets:
        for transition in net.transitions.values():
            if isinstance(transition.action, AwaitAction):
                yield transition.action


def split_name(name: str, nets: Sequence[Net]) -> tuple[str, str]:
    """Return the net, if given, and the rest of a name ``net.rest`` or ``rest``."""
    before, dot, rest = name.partition(".")
    return (before, rest) if dot and any(net.name == before for net in nets) else ("", name)


class _Names:
    """Check of the names in a file, and of fields against the types of messages."""

    def __init__(self, path: Path, nets: Sequence[Net]) -> None:
        self._path, self._nets = path, nets
        self._scopes = {net.name: NetScope(net, installed_types()) for net in nets}
        self._acting: dict[str, Iterable[str]] = {
            net.name: {t.retry_of or t.name for t in net.transitions.values() if t.action is not None} for net in nets
        }
        self._transitions: dict[str, Iterable[str]] = {net.name: (*net.transitions, *net.services) for net in nets}
        self._places: dict[str, Iterable[str]] = {net.name: net.places for net in nets}

    def check(self, file: ScenariosFile) -> None:
        """Check a file.

        Raises:
            ConfigError: A name is not known, or an argument is wrong.
        """
        self._answers((), file.answers)
        for name, scenario in file.scenarios.items():
            at: Location = ("scenarios", name)
            self._answers(at, scenario.answers)
            self._guards((*at, "guards"), scenario.guards)
            self._objects((*at, "objects"), scenario.objects)
            for rank, step in enumerate(scenario.steps):
                self._step((*at, "steps", rank), step, partly=scenario.random is not None)
            expected = (*at, "expect")
            for key in ("order", "never"):
                for rank, text in enumerate(getattr(scenario.expect, key)):
                    self._find((*expected, key, rank), "transition", text.rstrip(MARKS), self._transitions)
            for place in scenario.expect.marking:
                self._find((*expected, "marking", place), "place", place, self._places)

    def _answers(self, at: Location, answers: Answers) -> None:
        for name, several in answers.items():
            found, short = self._find((*at, "answers", name), "transition with an action", name, self._acting)
            net = next(each for each in self._nets if each.name == found)
            transition = net.transitions[short]
            action, scope = transition.action, self._scopes[found].meanings(transition)
            for rank, answer in enumerate(several):
                where: Location = (*at, "answers", name, *((rank,) if len(several) > 1 else ()))
                if isinstance(action, ServiceAction | GoalAction | AwaitAction):
                    answered = message_type(f"{action.type}{ANSWERED[type(action)]}")
                    self._fields((*where, "answer"), answer.answer, answered, scope)
                if isinstance(action, ServiceAction | GoalAction):
                    sent = message_type(f"{action.type}{SENT[type(action)]}")
                    schemas = [net.arguments_of(kind) for kind in self._scopes[found].works_for(transition)]
                    fields = {
                        key: value
                        for key, value in answer.when.items()
                        if not any(schema is None or key in schema.arguments for schema in schemas)
                    }
                    self._fields((*where, "when"), fields, sent, scope)

    def _objects(self, at: Location, objects: Objects) -> None:
        scopes = [self._scopes[net.name].meanings(next(iter(net.transitions.values()))) for net in self._nets]
        known = {
            place.data_object: scope
            for net, scope in zip(self._nets, scopes, strict=True)
            for place in net.places.values()
            if place.data_object
        }
        for name, fields in objects.items():
            if name not in known:
                if any(has_expressions(each) for each in known):
                    continue  # such as path/${arguments.group}
                raise self._unknown((*at, name), "data object", name, known)
            try:
                kind = known[name].data(name)
            except ExpressionError:
                continue  # no place says of what type it is
            self._fields((*at, name), fields, kind, known[name])

    def _fields(self, at: Location, fields: Fields, wanted: ValueType, scope: Meanings) -> None:
        try:
            check_value(fields, wanted, scope)
        except PlacedError as error:
            raise fault_in(self._path, (*at, *error.location), error.sentence) from error
        except ConfigError:
            return  # a type that is not installed here

    def _guards(self, at: Location, guards: Iterable[str]) -> None:
        known = {name for net in self._nets for name in net.guards()}
        for name in guards:
            if name not in known:
                raise self._unknown((*at, name), "guard", name, known)

    def _step(self, at: Location, step: StepFile, *, partly: bool) -> None:
        if step.during is not None:
            acting = {net.name: [t.name for t in net.transitions.values() if t.action] for net in self._nets}
            self._find((*at, "while"), "transition with an action", step.during, acting)
        topics = {each.name: each.type for each in awaits(self._nets)}
        for topic, fields in step.messages.items():
            if topic not in topics:
                raise self._unknown((*at, "messages", topic), "awaited topic", topic, topics)
            scope = self._scopes[self._nets[0].name].meanings(next(iter(self._nets[0].transitions.values())))
            self._fields((*at, "messages", topic), fields, message_type(topics[topic]), scope)
        self._objects((*at, "objects"), step.objects)
        symbols: dict[str, Iterable[str]] = {net.name: net.symbols() for net in self._nets}
        services: dict[str, Iterable[str]] = {net.name: net.services for net in self._nets}
        self._guards((*at, "guards"), step.guards)
        if step.cancel is not None:
            both = {name: (*symbols[name], *services[name]) for name in symbols}
            self._find((*at, "cancel"), "symbol or service", step.cancel, both)
        key, known = ("symbol", symbols) if step.symbol is not None else ("request", services)
        if (asked := step.symbol or step.request) is None:
            return
        net, name = self._find((*at, key), "symbol" if step.symbol else "service", asked, known)
        schema = next(each for each in self._nets if each.name == net).arguments_of(name)
        if schema is None:
            return
        try:
            schema.require_known(step.arguments, asked)
            for argument in step.arguments:
                schema.arguments[argument].check(step.arguments[argument])
            if not partly:
                schema.require_given(step.arguments, asked)
        except ImError as error:
            raise fault_in(self._path, (*at, "arguments"), error.message) from error

    def _find(self, at: Location, what: str, name: str, known: Mapping[str, Iterable[str]]) -> tuple[str, str]:
        """Return the net and the name there.

        Raises:
            ConfigError: There is none of the name, or in several nets.
        """
        net, rest = split_name(name, self._nets)
        found = [each for each, names in known.items() if rest in names and net in ("", each)]
        if len(found) == 1:
            return found[0], rest
        if found:
            sentence = f"{what} '{name}' is in the nets {', '.join(found)}; write {found[0]}.{name}"
            raise fault_in(self._path, at, sentence)
        raise self._unknown(at, what, name, [each for names in known.values() for each in names])

    def _unknown(self, at: Location, what: str, name: str, known: Iterable[str]) -> ImError:
        return fault_in(self._path, at, f"there is no {what} '{name}'{nearest(name, known)}")
