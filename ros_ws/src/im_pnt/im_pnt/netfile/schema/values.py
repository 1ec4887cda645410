"""Kinds of values in a net file, each with the check and the JSON schema."""

import re
from dataclasses import dataclass
from types import NoneType
from typing import Annotated, ClassVar, TypeVar, get_args

import pydantic
from pydantic import BeforeValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, WithJsonSchema
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from im_core.config import Model
from im_pnt.model.net import LARGEST
from im_pnt.netfile.schema.names import MAX_NAME, NAME, NAME_RULE, QUALIFIED, is_name, is_qualified, shown_name
from im_pnt.netfile.schema.scalars import (
    WrongKeyError,
    as_arcs,
    as_fields,
    as_list,
    as_mapping,
    as_number,
    as_text,
    as_truth,
    as_whole,
    shown,
)


@dataclass(frozen=True, slots=True)
class TextForm:
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
            text = as_text(value)
            if len(text) > self.longest or not matches(text):
                raise ValueError(f"{shown(value)} {self.says}")
            return text

        return core_schema.no_info_plain_validator_function(check)

    def __get_pydantic_json_schema__(self, _core: CoreSchema, _handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return self.schema()

    def schema(self) -> JsonSchemaValue:
        """Return the JSON schema."""
        types = ["string", "boolean"] if self.like_truth else "string"
        return {"type": types, "pattern": f"^{self.pattern}$", "maxLength": self.longest}


@dataclass(frozen=True, slots=True)
class NumberWithin:
    """A finite number within limits."""

    gt: float | None = None
    ge: float | None = None
    le: float | None = None

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        inner = core_schema.float_schema(gt=self.gt, ge=self.ge, le=self.le, strict=True)
        return core_schema.no_info_wrap_validator_function(self._read, inner)

    def _read(self, value: object, check: core_schema.ValidatorFunctionWrapHandler) -> object:
        number = as_number(value)
        try:
            return check(float(number) if type(number) is int else number)
        except pydantic.ValidationError:
            limits = ((">", self.gt), (">=", self.ge), ("<=", self.le))
            said = " and ".join(f"{sign} {limit:g}" for sign, limit in limits if limit is not None)
            raise ValueError(f"{shown(value)} is not a number {said}".rstrip()) from None


class GivenOnly:
    """Key with a value where present: an empty one is refused."""

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return handler.generate_schema(next(each for each in get_args(source) if each is not NoneType))


@dataclass(frozen=True, slots=True)
class Named:
    """Things by name.

    Attributes:
        reserved: Names that none may have.
        ours: Whether a file of another tool may have any names.
        qualified: Whether names may have dots, as those of a subnet's parts.
    """

    reserved: tuple[str, ...] = ()
    ours: bool = True
    qualified: bool = False

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        names: JsonSchemaValue = {"pattern": f"^{QUALIFIED if self.qualified else NAME}$", "maxLength": MAX_NAME}
        if self.reserved:
            names["not"] = {"enum": list(self.reserved)}
        return handler(core) | {"type": ["object", "null"], "propertyNames": names}

    def _check(self, value: object, info: core_schema.ValidationInfo) -> dict[str, object]:
        entries = as_mapping(value)
        if self.ours or not info.context:
            fits = is_qualified if self.qualified else is_name
            for name in entries:
                if not fits(name):
                    raise WrongKeyError((name,), f"'{shown_name(name)}' is not a name ({NAME_RULE})")
                if name in self.reserved:
                    raise WrongKeyError((name,), f"the name '{shown_name(name)}' belongs to the coordination structure")
        return entries


ValueT = TypeVar("ValueT")
Given = Annotated[ValueT | None, GivenOnly()]
ONE_TEXT: JsonSchemaValue = {"type": ["string", "number", "boolean"]}
COUNT: JsonSchemaValue = {"type": "integer", "minimum": 0, "maximum": LARGEST}
Text = Annotated[str, BeforeValidator(as_text), WithJsonSchema(ONE_TEXT)]
NAME_FORM = TextForm(NAME, f"is not a name ({NAME_RULE})", like_truth=True, longest=MAX_NAME)
Name = Annotated[str, NAME_FORM]


class OneOrMore:
    """List, or the only element; nothing is the empty one."""

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(as_list, handler(source))

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        one = handler(core)["items"]
        return {"anyOf": [one, {"type": "array", "items": one}, {"type": "null"}]}


Texts = Annotated[tuple[Text, ...], OneOrMore()]
Names = Annotated[tuple[Name, ...], OneOrMore()]
Fields = Annotated[dict[str, object], BeforeValidator(as_fields), WithJsonSchema({"type": ["object", "null"]})]
Truth = Annotated[bool, BeforeValidator(as_truth)]
Count = Annotated[int, Field(ge=0, le=LARGEST), BeforeValidator(as_whole)]
Weight = Annotated[int, Field(ge=1, le=LARGEST), BeforeValidator(as_whole)]
Arcs = Annotated[
    dict[str, Weight],
    BeforeValidator(as_arcs),
    WithJsonSchema(
        {
            "anyOf": [
                ONE_TEXT,
                {"type": "array", "items": ONE_TEXT},
                {"type": "object", "additionalProperties": COUNT | {"minimum": 1}},
                {"type": "null"},
            ]
        }
    ),
]
ARCS = pydantic.TypeAdapter[dict[str, int]](Arcs)
Positive = Annotated[float, NumberWithin(gt=0.0)]
NotNegative = Annotated[float, NumberWithin(ge=0.0)]
PlaceName = Text
FUNCTION = rf"{NAME}(?:(?:\.{NAME})*:{NAME})?"
Function = Annotated[str, TextForm(FUNCTION, "is neither a name nor module:function", like_truth=True)]


class FilePart(Model):
    """A mapping of a net file; nothing is the empty one.

    Attributes:
        short_forms: Schemas of what an author may write instead.
    """

    short_forms: ClassVar[tuple[JsonSchemaValue, ...]] = ()

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return as_mapping(value)

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


def type_form(kind: str) -> TextForm:
    """Return the form of a type of ROS: package/msg/Type, or srv or action in place of msg."""
    return TextForm(f"{_TYPE}/{kind}/{_TYPE}", f"is not of the form package/{kind}/Type")
