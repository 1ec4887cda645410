"""What a net file may say: the models that check it, from which the JSON schema for editors is made.

A value that an author may write shortly (``a: 1`` for a place, ``in: a`` for arcs, ``delay: 2.5``) is brought into its
long form before it is checked; a scalar keeps how it is written, for it may stand where a text is wanted.
"""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from types import NoneType
from typing import Annotated, ClassVar, Literal, Self, TypeVar, get_args

import pydantic
from pydantic import BeforeValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, WithJsonSchema
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from im_core.config import FieldError, Model
from im_core.errors import nearest
from im_core.yamltext import Value, control_character, plain_scalar, quoted_text
from im_pnt.model.arguments import ArgumentType
from im_pnt.model.expand import INPUT_SEMAPHORE, OUTPUT_SEMAPHORE
from im_pnt.model.net import LARGEST

MAX_NAME = 200
"""Longest name [characters]."""

_NAME = "[A-Za-z_][A-Za-z0-9_]*"
_NAME_RULE = f"letters, digits and _, not starting with a digit, at most {MAX_NAME}"
_COORDINATION = (INPUT_SEMAPHORE, OUTPUT_SEMAPHORE)
ACTIONS = ("action", "service", "goal", "topic", "await", "request")
"""Keys of which a transition may have one."""

_EFFECTS = (*ACTIONS, "result", "store")
"""Keys by which a transition does something that can fail."""

_NEED_ACTION = ("on_failure", "on_doubt", "timeout", "tries", "success", "strategy", "acts_on")
MOST_TRIES = 100


class WrongKeyError(FieldError):
    """A rule that is broken by a key, not by its value."""


class Written(str):
    """An unquoted number or truth value: its text, and what it is."""

    __slots__ = ("value",)
    value: object


def written(value: Value) -> object:
    """Returns a scalar as the models take it: a text, None, or :class:`Written`."""
    data = plain_scalar(value)
    if isinstance(data, str) or data is None:
        return data
    scalar = Written(value.text)
    scalar.value = data
    return scalar


def is_name(text: str) -> bool:
    """Whether a text is letters, digits and _, does not start with a digit, and is not too long."""
    return len(text) <= MAX_NAME and re.fullmatch(_NAME, text) is not None


def as_name(text: str) -> str:
    """Makes a name of any text, with _ for what a name cannot have."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)[: MAX_NAME - 10] or "_"
    return f"_{name}" if name[0].isdigit() else name


def shown_name(name: str) -> str:
    """Returns a name for messages, the beginning of a long one."""
    return name if len(name) <= MAX_NAME else name[:60] + "..."


def _shown(value: object) -> str:
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    return "nothing" if value is None else quoted_text(str(value))


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{_shown(value)} is not a text")
    if sentence := control_character(value):
        raise ValueError(sentence)
    return str(value)


def _number(value: object) -> object:
    """What a scalar is besides a text; numbers are finite and exact."""
    if not isinstance(value, Written):
        return value
    number = value.value
    if isinstance(number, float) and (not math.isfinite(number) or value.lstrip("-+").isdigit()):
        raise ValueError(f"{_shown(value)} is not a finite number of at most 20 digits")
    return number


def _whole(value: object) -> int:
    number = _number(value)
    if isinstance(number, bool) or not isinstance(number, int):
        raise ValueError(f"{_shown(value)} is not a whole number")
    return number


def _truth(value: object) -> bool:
    truth = _number(value)
    if not isinstance(truth, bool):
        raise ValueError(f"{_shown(value)} is neither true nor false")
    return truth


def _plain(value: object) -> object:
    """A value that means what it means to somebody else."""
    if isinstance(value, dict):
        return {name: _plain(child) for name, child in value.items()}
    if isinstance(value, list):
        return [_plain(child) for child in value]
    return _number(value)


def _mapping(value: object) -> dict[str, object]:
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ValueError(f"{_shown(value)} is not a mapping (key: value)")
    return value


def _fields(value: object) -> dict[str, object]:
    return {name: _plain(child) for name, child in _mapping(value).items()}


def _listed(value: object) -> list[object]:
    """A single value counts as a list of one."""
    if isinstance(value, dict):
        raise ValueError("a mapping is not a list")
    if value is None:
        return []
    return value if isinstance(value, list) else [value]


def _uses(value: object) -> object:
    """The only use may stand without a list around it."""
    return [value] if isinstance(value, dict) else value


def _arcs(value: object) -> dict[str, object]:
    """``a``, ``[a, b]`` or ``{a: 2}`` as places with weights."""
    if isinstance(value, dict):
        return value
    weights: dict[str, int] = {}
    for rank, element in enumerate(_listed(value)):
        if not isinstance(element, str):
            raise FieldError((rank,), f"{_shown(element)} is not a text")
        weights[str(element)] = weights.get(str(element), 0) + 1
    return dict(weights)


@dataclass(frozen=True, slots=True)
class _Form:
    """A text of a form.

    Attributes:
        pattern: The form.
        says: What is said of another: ``is not a name``.
        like_truth: Whether an unquoted truth value may be one.
        longest: Greatest number of characters.
    """

    pattern: str
    says: str
    like_truth: bool = False
    longest: int = 1000

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        matches = re.compile(self.pattern).fullmatch

        def check(value: object) -> str:
            text = _text(value)
            if len(text) > self.longest or not matches(text):
                raise ValueError(f"{_shown(value)} {self.says}")
            return text

        return core_schema.no_info_plain_validator_function(check)

    def __get_pydantic_json_schema__(self, _core: CoreSchema, _handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return self.schema()

    def schema(self) -> JsonSchemaValue:
        """Returns the JSON schema."""
        types = ["string", "boolean"] if self.like_truth else "string"
        return {"type": types, "pattern": f"^{self.pattern}$", "maxLength": self.longest}


@dataclass(frozen=True, slots=True)
class _Number:
    """A finite number within limits."""

    gt: float | None = None
    ge: float | None = None
    le: float | None = None

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        inner = core_schema.float_schema(gt=self.gt, ge=self.ge, le=self.le, strict=True)
        return core_schema.no_info_wrap_validator_function(self._read, inner)

    def _read(self, value: object, check: core_schema.ValidatorFunctionWrapHandler) -> object:
        number = _number(value)
        try:
            return check(float(number) if type(number) is int else number)
        except pydantic.ValidationError:
            limits = ((">", self.gt), (">=", self.ge), ("<=", self.le))
            said = " and ".join(f"{sign} {limit:g}" for sign, limit in limits if limit is not None)
            raise ValueError(f"{_shown(value)} is not a number {said}".rstrip()) from None


class _Given:
    """A key may be missing, but says something where it is there: nothing is no value of it."""

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return handler.generate_schema(next(each for each in get_args(source) if each is not NoneType))


@dataclass(frozen=True, slots=True)
class _Entries:
    """Things by name.

    Attributes:
        reserved: Names that none may have.
        ours: Whether a file of another tool may have any names.
    """

    reserved: tuple[str, ...] = ()
    ours: bool = True

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        names: JsonSchemaValue = {"pattern": f"^{_NAME}$", "maxLength": MAX_NAME}
        if self.reserved:
            names["not"] = {"enum": list(self.reserved)}
        return handler(core) | {"type": ["object", "null"], "propertyNames": names}

    def _check(self, value: object, info: core_schema.ValidationInfo) -> dict[str, object]:
        entries = _mapping(value)
        if self.ours or not info.context:
            for name in entries:
                if not is_name(name):
                    raise WrongKeyError((name,), f"'{shown_name(name)}' is not a name ({_NAME_RULE})")
                if name in self.reserved:
                    raise WrongKeyError((name,), f"the name '{name}' belongs to the coordination structure")
        return entries


ValueT = TypeVar("ValueT")
Given = Annotated[ValueT | None, _Given()]
_ONE_TEXT: JsonSchemaValue = {"type": ["string", "number", "boolean"]}
_COUNT: JsonSchemaValue = {"type": "integer", "minimum": 0, "maximum": LARGEST}
Text = Annotated[str, BeforeValidator(_text), WithJsonSchema(_ONE_TEXT)]
_NAME_FORM = _Form(_NAME, f"is not a name ({_NAME_RULE})", like_truth=True, longest=MAX_NAME)
Name = Annotated[str, _NAME_FORM]


class _OneOrMore:
    """A list, or its only element; nothing is the empty one."""

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(_listed, handler(source))

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        one = handler(core)["items"]
        return {"anyOf": [one, {"type": "array", "items": one}, {"type": "null"}]}


Texts = Annotated[tuple[Text, ...], _OneOrMore()]
Names = Annotated[tuple[Name, ...], _OneOrMore()]
Fields = Annotated[dict[str, object], BeforeValidator(_fields), WithJsonSchema({"type": ["object", "null"]})]
Truth = Annotated[bool, BeforeValidator(_truth)]
Count = Annotated[int, Field(ge=0, le=LARGEST), BeforeValidator(_whole)]
Weight = Annotated[int, Field(ge=1, le=LARGEST), BeforeValidator(_whole)]
Arcs = Annotated[
    dict[str, Weight],
    BeforeValidator(_arcs),
    WithJsonSchema(
        {
            "anyOf": [
                _ONE_TEXT,
                {"type": "array", "items": _ONE_TEXT},
                {"type": "object", "additionalProperties": _COUNT | {"minimum": 1}},
                {"type": "null"},
            ]
        }
    ),
]
ARCS = pydantic.TypeAdapter[dict[str, int]](Arcs)
Positive = Annotated[float, _Number(gt=0.0)]
NotNegative = Annotated[float, _Number(ge=0.0)]
PlaceName = Text
_FUNCTION = rf"{_NAME}(?:(?:\.{_NAME})*:{_NAME})?"
Function = Annotated[str, _Form(_FUNCTION, "is neither a name nor module:function", like_truth=True)]


class _Part(Model):
    """A mapping of a net file; nothing is the empty one.

    Attributes:
        short_forms: Schemas of what an author may write instead.
    """

    short_forms: ClassVar[tuple[JsonSchemaValue, ...]] = ()

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return _mapping(value)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        reference = handler(core)
        schema = handler.resolve_ref_schema(reference)
        schema.pop("title", None)
        if not {"required", "minProperties"} & schema.keys():
            schema["type"] = ["object", "null"]
        if cls.short_forms:
            mapping = {key: schema.pop(key) for key in list(schema) if key != "description"}
            schema["anyOf"] = [*cls.short_forms, mapping]
        return reference


_TYPE = "[A-Za-z][A-Za-z0-9_]*"


def _type(kind: str) -> _Form:
    return _Form(f"{_TYPE}/{kind}/{_TYPE}", f"is not of the form package/{kind}/Type")


class ObjectFile(_Part):
    """A data object: its name, or its keys."""

    short_forms = (_ONE_TEXT,)

    name: Text = Field(description="Its name.")
    type: Given[Annotated[str, _type("msg")]] = Field(None, description="Its type, package/msg/Type.")
    scope: Literal["command", "global"] = Field(
        "command", description="command: each command has its own; global: there is one for the machine."
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return value if isinstance(value, dict) else {"name": value}


class PlaceFile(_Part):
    """A place: nothing, its tokens, or its keys."""

    model_config = pydantic.ConfigDict(json_schema_extra={"dependentRequired": {"on_invalid": ["data_object"]}})
    short_forms = (_COUNT,)

    tokens: Count = Field(0, description="Tokens of the initial marking.")
    capacity: Given[Weight] = Field(
        None, description="Bound that verification proves; a net that can exceed it is refused."
    )
    data_object: Given[ObjectFile] = Field(
        None, description="Data object whose existence and validity the place stands for: its name, or its keys."
    )
    on_invalid: Texts = Field((), description="Places to which its tokens go when the object loses its validity.")
    remote: Truth = Field(False, description="Whether transitions of other nets may mark it.")
    resource: Given[Truth] = Field(
        None, description="Whether its tokens belong to nobody, and carry no command; not said: it is derived."
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return value if isinstance(value, dict) else {} if value is None else {"tokens": value}

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.capacity is not None and self.tokens > self.capacity:
            raise ValueError(f"{self.tokens} tokens are more than the capacity of {self.capacity}")
        if "on_invalid" in self.model_fields_set and self.data_object is None:
            raise WrongKeyError(("on_invalid",), "needs a data_object whose loss of validity it answers")
        return self


def _length(value: object) -> tuple[int, int]:
    """``9``, or ``[1, 9]``."""
    numbers = [_whole(each) for each in value] if isinstance(value, list) else [_whole(value)] * 2
    if len(numbers) != 2 or not 0 <= numbers[0] <= LARGEST or not 0 <= numbers[1] <= LARGEST:
        raise ValueError(f"{numbers} is no length: a number >= 0, or [least, most], is needed")
    if numbers[1] < numbers[0]:
        raise ValueError(f"{numbers} goes from {numbers[0]} to less, {numbers[1]}")
    return numbers[0], numbers[1]


def _choices(value: object) -> list[object]:
    return [_plain(each) for each in _listed(value)]


_Limit = Annotated[float, Field(allow_inf_nan=False, strict=True), BeforeValidator(_number)]
_ANY: JsonSchemaValue = {"type": ["string", "number", "boolean", "array", "object", "null"]}


class ArgumentFile(_Part):
    """What an argument may be."""

    type: Literal["boolean", "integer", "number", "string", "booleans", "integers", "numbers", "strings", "object"] = (
        Field(description="What its value is; those in the plural are lists, object is any JSON.")
    )
    unit: Text = Field("", description="Unit of its numbers, as m or rad/s.")
    minimum: Given[_Limit] = Field(None, description="Least number, also of each element of a list.")
    maximum: Given[_Limit] = Field(None, description="Greatest number, also of each element of a list.")
    choices: Annotated[tuple[object, ...], BeforeValidator(_choices), WithJsonSchema({"type": "array"})] = Field(
        (), description="What the value, or each element of a list, is one of."
    )
    length: Given[
        Annotated[
            tuple[int, int],
            pydantic.PlainValidator(_length),
            WithJsonSchema({"anyOf": [_COUNT, {"type": "array", "items": _COUNT, "minItems": 2, "maxItems": 2}]}),
        ]
    ] = Field(None, description="Elements of a list, or characters of a text: a number, or [least, most].")
    default: Annotated[object, BeforeValidator(_plain), WithJsonSchema(_ANY)] = Field(
        None, description="Its value where it is not given; without it, it must be given."
    )
    help: Text = Field("", description="One line for people.")

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        kind, given = ArgumentType(self.type), self.model_fields_set
        for key in ("minimum", "maximum", "unit"):
            if key in given and not kind.is_numeric:
                raise WrongKeyError((key,), f"is for numbers; the argument is of type {kind}")
        if "length" in given and not kind.is_list and kind is not ArgumentType.STRING:
            raise WrongKeyError(("length",), f"is for lists and texts; the argument is of type {kind}")
        if self.minimum is not None and self.maximum is not None and self.maximum < self.minimum:
            raise FieldError(("maximum",), f"{self.maximum:g} is less than the minimum {self.minimum:g}")
        return self


Arguments = Annotated[dict[str, ArgumentFile], _Entries()]


class CommandFile(_Part):
    """A command: a symbol that begins one."""

    description: Text = Field("", description="One line for people.")
    arguments: Arguments = Field({}, description="What it takes, by name; others are refused.")
    needs: Texts = Field(
        (), description="Resources that it holds while it is under way; ${arguments.NAME} in them is an argument."
    )
    busy: Literal["wait", "refuse"] = Field("wait", description="What becomes of it where others hold these.")
    priority: Annotated[int, Field(ge=-10, le=10), BeforeValidator(_whole)] = Field(
        0, description="Larger goes first, where several wait for the same."
    )


class ServiceFile(_Part):
    """A service offered through a coordination structure."""

    entry: PlaceName = Field(description="Place marked when a request is accepted.")
    done: PlaceName = Field(description="Place that means success.")
    failed: PlaceName = Field(description="Place that means failure.")
    arguments: Given[Arguments] = Field(
        None, description="What it takes, by name; others are refused. Without it, it takes anything."
    )
    acts_on: Given[Texts] = Field(
        None, description="Resources that it acts on, which who asks for it holds; ${arguments.NAME} is an argument."
    )

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if len({self.entry, self.done, self.failed}) < 3:
            raise ValueError("entry, done and failed must be three different places")
        return self


_SERVICE = _Form(rf"{_NAME}\.{_NAME}", "is not of the form net.service")
_REMOTE = _Form(rf"{_NAME}\.{_NAME}", "is not of the form net.place")


class _MessageFile(_Part):
    name: Text = Field(description="Name of the service, action or topic.")
    build: Given[Function] = Field(None, description="Registered function that makes further fields.")


class _CallFile(_MessageFile):
    handle: Given[Function] = Field(None, description="Registered function that reads the answer.")
    task: Given[Name] = Field(None, description="Task that answers, whose death ends the wait.")


class TopicFile(_MessageFile):
    """A message."""

    type: Annotated[str, _type("msg")] = Field(description="Its type, package/msg/Type.")
    message: Fields = Field({}, description="Fields of the message.")


class AwaitFile(_Part):
    """A message that is waited for."""

    name: Text = Field(description="Name of the topic.")
    type: Annotated[str, _type("msg")] = Field(description="Its type, package/msg/Type.")
    latched: Truth = Field(
        False, description="Whether the last message of a latched topic, published before, counts too."
    )
    until: Given[Annotated[str, _Form(r"\$\{.*\}", "is not a condition ${...}")]] = Field(
        None, description="Condition on the message, answers.TRANSITION of its own transition; others are passed over."
    )
    handle: Given[Function] = Field(None, description="Registered function that reads the message.")


class ServiceCallFile(_CallFile):
    """A call of a ROS service."""

    type: Annotated[str, _type("srv")] = Field(description="Its type, package/srv/Type.")
    request: Fields = Field({}, description="Fields of the request.")


class GoalFile(_CallFile):
    """A ROS action goal."""

    type: Annotated[str, _type("action")] = Field(description="Its type, package/action/Type.")
    goal: Fields = Field({}, description="Fields of the goal.")


class RequestFile(_Part):
    """A request to another net: net.service, or its keys."""

    short_forms = (_SERVICE.schema(),)

    to: Annotated[str, _SERVICE] = Field(description="The service, net.service.")
    arguments: Fields = Field({}, description="Arguments of the request.")
    build: Given[Function] = Field(None, description="Registered function that makes further arguments.")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return value if isinstance(value, dict) else {"to": value}


class ConstantFile(_Part):
    """Always the same."""

    value: NotNegative = Field(description="[s]")


class ExponentialFile(_Part):
    """Without memory; rate [1/s] or mean [s]."""

    model_config = pydantic.ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    rate: Given[Annotated[float, Field(gt=0.0), BeforeValidator(_number)]] = Field(None, description="[1/s]")
    mean: Given[Annotated[float, Field(gt=0.0), BeforeValidator(_number)]] = Field(None, description="[s]")

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.rate is None) == (self.mean is None):
            raise ValueError("needs either rate [1/s] or mean [s]")
        for name, value in (("rate", self.rate), ("mean", self.mean)):
            if value is not None and not 1.0 / value < math.inf:
                raise FieldError((name,), f"{name} {value:g} is too small")
        return self


class UniformFile(_Part):
    """Anything from low to high alike."""

    low: NotNegative = Field(description="[s]")
    high: Positive = Field(description="[s]")


class TriangularFile(_Part):
    """From low to high, most often mode."""

    low: NotNegative = Field(description="[s]")
    high: Positive = Field(description="[s]")
    mode: NotNegative = Field(description="[s]")


class GammaFile(_Part):
    """Mean shape times scale."""

    shape: Positive = Field(description="Shape, without unit.")
    scale: Positive = Field(description="[s]")


class WeibullFile(_Part):
    """Times to failure."""

    scale: Positive = Field(description="[s]")
    shape: Positive = Field(description="Shape, without unit.")


class LognormalFile(_Part):
    """Its logarithm is normal with mean mu and deviation sigma."""

    mu: Annotated[float, _Number()] = Field(description="Mean of the logarithm.")
    sigma: NotNegative = Field(description="Deviation of the logarithm.")


class DelayFile(_Part):
    """One distribution of times [s]."""

    model_config = pydantic.ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})
    short_forms = ({"type": "number", "minimum": 0},)

    constant: Given[ConstantFile] = None
    exponential: Given[ExponentialFile] = None
    uniform: Given[UniformFile] = None
    triangular: Given[TriangularFile] = None
    gamma: Given[GammaFile] = None
    weibull: Given[WeibullFile] = None
    lognormal: Given[LognormalFile] = None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        if not isinstance(value, dict):
            return {"constant": {"value": value}}
        kinds = cls.model_fields.keys()
        if len(value) != 1:
            raise ValueError(f"names {len(value)} distributions; one of {', '.join(kinds)} is allowed")
        ((kind, parameters),) = value.items()
        if kind not in kinds:
            raise WrongKeyError((kind,), f"there is no distribution '{kind}'{nearest(kind, kinds)}")
        if not isinstance(parameters, dict):
            raise FieldError((kind,), f"is not a mapping with {', '.join(_delay_keys(kind))}")
        return value


def _delay_keys(kind: str) -> tuple[str, ...]:
    """Parameters of a distribution."""
    model = next(each for each in get_args(DelayFile.model_fields[kind].annotation) if each is not NoneType)
    return tuple(model.model_fields)


class StrategyFile(_Part):
    """A probability of success that is learned."""

    successes: Positive = Field(1.0, description="Successes counted before the first run.")
    failures: Positive = Field(1.0, description="Failures counted before the first run.")
    decay: Annotated[float, _Number(gt=0.0, le=1.0)] = Field(
        1.0, description="Factor on both counts at each outcome; 1 forgets nothing."
    )


class SymbolFile(_Part):
    """A symbol of the input tape: its name, or its keys."""

    short_forms = (_NAME_FORM.schema(),)

    name: Name = Field(description="The symbol.")
    of: Given[Literal["command", "nobody"]] = Field(
        None,
        description="command: it is a word to a command under way, and waits for one that asks for it; nobody: it "
        "begins no command; not said: with tokens of nobody it begins a command.",
    )
    expires: Given[NotNegative] = Field(
        None,
        description="Time for which it waits to be read [s]; 0: it does not wait when nothing else happens any more.",
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return value if isinstance(value, dict) else {"name": value}


class TransitionFile(_Part):
    """A transition: it takes the tokens of 'in', does its action, then gives those of 'out'."""

    model_config = pydantic.ConfigDict(
        json_schema_extra={
            "dependentSchemas": {
                **{key: {"anyOf": [{"required": [effect]} for effect in _EFFECTS]} for key in _NEED_ACTION},
                **{
                    action: {"not": {"anyOf": [{"required": [other]} for other in ACTIONS if other != action]}}
                    for action in ACTIONS
                },
            }
        }
    )

    inputs: Arcs = Field({}, alias="in", description="Tokens it takes.")
    outputs: Arcs = Field(
        {},
        alias="out",
        description="Tokens it gives when its action has confirmed; net.place is a place of another net.",
    )
    inhibitors: Arcs = Field({}, description="It is disabled while one of these places holds that many tokens or more.")
    resets: Texts = Field((), description="Places that it empties when it has taken its tokens.")
    guard: Given[
        Annotated[
            str,
            _Form(
                rf"\s*(not\s+)?({_FUNCTION}|\$\{{.*\}})\s*",
                "is not a name or ${...}, nor 'not' and one of these",
                like_truth=True,
            ),
        ]
    ] = Field(None, description="Enabling function by its registered name, or ${...}; or 'not' and one of these.")
    symbol: Given[SymbolFile] = Field(None, description="Symbol it needs from the input tape: its name, or its keys.")
    emit: Names = Field((), description="Symbols it writes to the output tape when it ends.")
    action: Given[Function] = Field(None, description="Calls a registered function, or module:function.")
    service: Given[ServiceCallFile] = Field(None, description="Calls a ROS service.")
    goal: Given[GoalFile] = Field(None, description="Sends a ROS action goal.")
    topic: Given[TopicFile] = Field(None, description="Publishes a message.")
    awaited: Given[AwaitFile] = Field(None, alias="await", description="Waits for a message of a topic.")
    request: Given[RequestFile] = Field(None, description="Asks another net for a service: net.service, or its keys.")
    acts_on: Given[Texts] = Field(
        None,
        description="Resources that its action acts on, where the file does not tell them otherwise; "
        "${arguments.NAME} in them is an argument; [] is nothing.",
    )
    result: Fields = Field({}, description="Values that the command or request returns when it ends well, by name.")
    store: Fields = Field({}, description="Values of data objects that are put when it ends well, by object.")
    on_failure: Arcs = Field({}, description="Tokens it gives instead when the action fails.")
    on_doubt: Arcs = Field(
        {},
        description="Tokens it gives when nobody can tell what became of the action; "
        "without it, that counts as failed.",
    )
    timeout: Given[Positive] = Field(
        None, description="Time the action may take [s] before it is asked what became of it."
    )
    tries: Annotated[int, Field(ge=1, le=MOST_TRIES), BeforeValidator(_whole)] = Field(
        1, description="How often the action is tried before its tokens go to on_failure."
    )
    retry_of: Given[Text] = Field(
        None, description="Transition whose further try it is, and as whose answer its own counts; 'tries' writes it."
    )
    delay: Given[DelayFile] = Field(
        None,
        description="Time of the action in simulation and analysis; of a transition without action, the time for "
        "which it must be enabled before it fires [s].",
    )
    success: Annotated[float, _Number(ge=0.0, le=1.0)] = Field(
        1.0, description="Probability that the action succeeds, in simulation and analysis."
    )
    weight: Positive = Field(
        1.0, description="How often it is taken among contending transitions, relative to the others."
    )
    strategy: Given[StrategyFile] = Field(
        None, description="Its probability of success is learned from outcomes, and weighs in the choice."
    )
    priority: Annotated[int, Field(ge=-LARGEST, le=LARGEST), BeforeValidator(_whole)] = Field(
        0, description="Larger goes first among contending transitions."
    )

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        given = {type(self).model_fields[name].alias or name for name in self.model_fields_set}
        actions = [key for key in ACTIONS if key in given]
        if len(actions) > 1:
            raise ValueError(f"has {' and '.join(actions)}; one action is allowed")
        if not given & set(_EFFECTS):
            for key in _NEED_ACTION:
                if key in given:
                    raise WrongKeyError((key,), f"needs an action that can fail ({', '.join(_EFFECTS)})")
        return self


_MANY = 10_000
"""Most values that a range may have."""

_LARGEST_PARAMETER = 10**9
_RANGE = re.compile(r"(-?[0-9]{1,9})\.\.(-?[0-9]{1,9})")
Parameter = int | str


def _parameter(value: object) -> Parameter:
    number = _number(value)
    if isinstance(number, int) and not isinstance(number, bool) and abs(number) <= _LARGEST_PARAMETER:
        return number
    return _text(value)


def _range(value: object) -> Sequence[Parameter]:
    """``0..4``, or a list of numbers and texts; a range takes no memory before it is run through."""
    if not isinstance(value, str):
        values: list[Parameter] = []
        for rank, element in enumerate(_listed(value)):
            try:
                values.append(_parameter(element))
            except ValueError as error:
                raise FieldError((rank,), str(error)) from None
        return values
    match = _RANGE.fullmatch(_text(value).strip())
    if not match:
        raise ValueError(f"{_shown(value)} is neither a range like 0..4 nor a list of values")
    first, last = int(match.group(1)), int(match.group(2))
    if last - first >= _MANY:
        raise ValueError(f"{_shown(value)} has more than {_MANY} values")
    if last < first:
        raise ValueError(f"{_shown(value)} is empty: it ends before it begins")
    return range(first, last + 1)


_Parameter = Annotated[Parameter, pydantic.PlainValidator(_parameter), WithJsonSchema(_ONE_TEXT)]
_Range = Annotated[
    Sequence[Parameter],
    pydantic.PlainValidator(_range),
    WithJsonSchema(
        {"anyOf": [{"type": "string", "pattern": f"^{_RANGE.pattern}$"}, {"type": "array", "items": _ONE_TEXT}]}
    ),
]
_Section = Annotated[object, WithJsonSchema({"type": ["object", "null"]})]
_Rest = Annotated[object, WithJsonSchema({"type": ["array", "string", "null"]})]


class TemplateFile(_Part):
    """A part of a net with parameters; its sections are checked where they are copied."""

    parameters: Names = Field((), description="What each use gives.")
    places: _Section = Field(None, description="Places of each copy.")
    services: _Section = Field(None, description="Services of each copy.")
    commands: _Section = Field(None, description="Commands of each copy.")
    rest: _Rest = Field(None, description="Places of each copy that may hold tokens at rest.")
    transitions: _Section = Field(None, description="Transitions of each copy.")

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        seen = {"mod"}
        for rank, name in enumerate(self.parameters):
            if name in seen:
                sentence = f"'{name}' cannot be a parameter here: it is there twice, or an operator"
                raise FieldError(("parameters", rank), sentence)
            seen.add(name)
        return self


class UseFile(_Part):
    """Copies of one template."""

    template: Text = Field(description="Name of the template.")
    ranges: Annotated[dict[str, _Range], _Entries()] = Field(
        {},
        alias="for",
        description="Values to run through, one copy each (of several: each with each): a range 0..4, or a list.",
    )
    given: Annotated[dict[str, _Parameter], BeforeValidator(_mapping)] = Field(
        {},
        alias="with",
        description="Values of the other parameters; $(i+1 mod 5) may use those run through.",
        json_schema_extra={"type": ["object", "null"]},
    )


class AssumptionFile(_Part):
    """What is taken for granted of other nets, and proved where they are known."""

    model_config = pydantic.ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    at_most: Given[Weight] = Field(
        None, description="Most tokens under way to the place or in it, or most requests of the service, at once."
    )
    returns: Given[Annotated[str, _REMOTE]] = Field(
        None, description="other_net.place: for each token that is sent there one comes back in this place."
    )

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.at_most is None) == (self.returns is None):
            raise ValueError("say either at_most or returns")
        return self


class FragmentFile(_Part):
    """What a file may say that others include; its sections are checked when they are put together."""

    include: Texts = Field(
        (), description="Files with further places, services, transitions and templates; paths from this file."
    )
    templates: Annotated[dict[str, TemplateFile], _Entries()] = Field(
        {},
        description="Parts that are written once and copied by 'use'; $(i) in them is the value of parameter i, "
        "$(i+1 mod n) is reckoned.",
    )
    use: Annotated[tuple[UseFile, ...], _OneOrMore(), BeforeValidator(_uses)] = Field(
        (), description="Copies of templates."
    )
    places: object = None
    services: object = None
    commands: object = None
    rest: object = None
    transitions: object = None


class NetFile(FragmentFile):
    """A net: places, transitions, and what happens when they fire. docs/nets.md explains it with an example."""

    net: Name = Field(description="Name by which commands and other nets refer to this net.")
    description: Text = Field("", description="One line for people.")
    escalate: Given[PlaceName] = Field(
        None, description="Place for tokens of failed actions whose transition has no on_failure."
    )
    places: Annotated[dict[str, PlaceFile], _Entries(_COORDINATION, ours=False)] = Field(
        {}, description="Places by name: nothing, the tokens of the initial marking, or the keys of a place."
    )
    services: Annotated[dict[str, ServiceFile], _Entries()] = Field(
        {}, description="Services that other nets may request, by name."
    )
    commands: Annotated[dict[str, CommandFile], _Entries()] = Field(
        {}, description="What is said of symbols that begin a command, by symbol; others take any arguments."
    )
    assume: Annotated[dict[str, AssumptionFile], _Entries()] = Field(
        {}, description="What is taken for granted of other nets, by remote place or service of this one."
    )
    at_once: Weight = Field(1, description="Requests to its services that are served at once; others wait.")
    rest: Given[Texts] = Field(
        None,
        description="Places that may hold tokens while the net waits for a symbol or a request; "
        "without it, those marked initially.",
    )
    transitions: Annotated[dict[str, TransitionFile], _Entries(ours=False)] = Field(
        {}, description="Transitions by name."
    )


class _Schema(GenerateJsonSchema):
    """Without titles, which would only say the names again, and without defaults that are nothing."""

    def field_title_should_be_set(self, schema: object) -> bool:
        return False

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        described = super().default_schema(schema)
        return {key: value for key, value in described.items() if key != "default"}


def schema_text() -> str:
    """Returns the JSON schema (draft 2020-12) of net files, for editors."""
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:im:pnt:net.schema.json",
        "title": "Petri net transducer",
        **NetFile.model_json_schema(schema_generator=_Schema),
    }
    return json.dumps(schema, indent=2) + "\n"
