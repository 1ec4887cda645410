"""Templates of a net file, and the copies."""

import re
from collections.abc import Sequence
from typing import Annotated, Self

import pydantic
from pydantic import BeforeValidator, Field, WithJsonSchema

from im_core.config import FieldError
from im_pnt.expression.syntax import WORDS
from im_pnt.netfile.schema.commands import Arguments
from im_pnt.netfile.schema.names import shown_name
from im_pnt.netfile.schema.scalars import Written, WrongKeyError, as_list, as_mapping, as_number, as_text, shown
from im_pnt.netfile.schema.values import ONE_TEXT, Fields, FilePart, Given, Named, Names, Text, Texts, Truth

_MANY = 10_000
"""Most values that a range may have."""

_LARGEST_PARAMETER = 10**9
_RANGE = re.compile(r"(-?[0-9]{1,9})\.\.(-?[0-9]{1,9})")
Parameter = int | float | str | list[object] | dict[str, object]


def as_parameter(value: object) -> Parameter:
    """Read the value of a parameter: a whole number, a text, :class:`Written`, or a list or mapping of these.

    Raises:
        ValueError: There is none.
    """
    if isinstance(value, list):
        return [as_parameter(each) for each in value]
    if isinstance(value, dict):
        return {name: as_parameter(each) for name, each in value.items()}
    number = as_number(value)
    if isinstance(number, int) and not isinstance(number, bool) and abs(number) <= _LARGEST_PARAMETER:
        return number
    return value if isinstance(value, Written) else as_text(value)


def _range(value: object) -> Sequence[Parameter]:
    """Read ``0..4``, or a list of numbers and texts; a range is expanded only at the use."""
    if not isinstance(value, str):
        values: list[Parameter] = []
        for rank, element in enumerate(as_list(value)):
            try:
                values.append(as_parameter(element))
            except ValueError as error:
                raise FieldError((rank,), str(error)) from None
        return values
    match = _RANGE.fullmatch(as_text(value).strip())
    if not match:
        raise ValueError(f"{shown(value)} is neither a range like 0..4 nor a list of values")
    first, last = int(match.group(1)), int(match.group(2))
    if last - first >= _MANY:
        raise ValueError(f"{shown(value)} has more than {_MANY} values")
    if last < first:
        raise ValueError(f"{shown(value)} is empty: it ends before it begins")
    return range(first, last + 1)


_Parameter = Annotated[
    Parameter,
    pydantic.PlainValidator(as_parameter),
    WithJsonSchema({"anyOf": [ONE_TEXT, {"type": ["array", "object"]}]}),
]
_Range = Annotated[
    Sequence[Parameter],
    pydantic.PlainValidator(_range),
    WithJsonSchema(
        {"anyOf": [{"type": "string", "pattern": f"^{_RANGE.pattern}$"}, {"type": "array", "items": ONE_TEXT}]}
    ),
]
_Section = Annotated[object, WithJsonSchema({"type": ["object", "null"]})]
_Rest = Annotated[object, WithJsonSchema({"type": ["array", "string", "null"]})]


class PortsFile(FilePart):
    """Places of a subnet that are one with places at each use, by the keys under which the use names them."""

    inputs: Names = Field((), alias="in", description="Places that it takes tokens from; it may give some back.")
    outputs: Names = Field((), alias="out", description="Places that it gives tokens to.")
    on_failure: Names = Field((), description="Places that it gives tokens to after a failure.")


class SubnetUseFile(FilePart):
    """Transition that stands for a subnet."""

    use: Text = Field(description="Template with ports.")
    inputs: Texts = Field((), alias="in", description="Places of its ports in 'in', in their order.")
    outputs: Texts = Field((), alias="out", description="Places of its ports in 'out', in their order.")
    on_failure: Texts = Field((), description="Places of its ports in 'on_failure', in their order.")
    arguments: Fields = Field({}, description="Values of its arguments and parameters.")
    keeps_failure: Truth = Field(False, description="Whether each of its transitions does.")


class TemplateFile(FilePart):
    """Part of a net with parameters; the sections are checked in the copies. With ports it is a subnet."""

    parameters: Names = Field((), description="Names of the values that each use gives.")
    ports: Given[PortsFile] = Field(
        None, description="Places that are one with places at each use: it is a subnet, used as a transition."
    )
    arguments: Arguments = Field({}, description="Arguments of a subnet, as of a command.")
    results: Fields = Field({}, description="Values that a subnet returns, by name: answers.USE.NAME after its use.")
    places: _Section = Field(None, description="Places of each copy.")
    services: _Section = Field(None, description="Services of each copy.")
    commands: _Section = Field(None, description="Commands of each copy.")
    rest: _Rest = Field(None, description="Places of each copy that may hold tokens at rest.")
    transitions: _Section = Field(None, description="Transitions of each copy.")

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        for key in ("arguments", "results") if self.ports is None else ("services", "commands"):
            if key in self.model_fields_set:
                raise WrongKeyError((key,), f"is for templates {'with' if self.ports is None else 'without'} 'ports'")
        seen = set(WORDS)
        for rank, name in enumerate(self.parameters):
            if name in seen:
                sentence = f"'{shown_name(name)}' cannot be a parameter here: it is there twice, or an operator"
                raise FieldError(("parameters", rank), sentence)
            seen.add(name)
        both = next((name for name in self.arguments if name in self.parameters), None)
        if both is not None:
            raise WrongKeyError(("arguments", both), "is a parameter, too")
        return self


class UseFile(FilePart):
    """Copies of one template."""

    template: Text = Field(description="Name of the template.")
    ranges: Annotated[dict[str, _Range], Named()] = Field(
        {},
        alias="for",
        description="Values to run through, one copy each (of several: each with each): a range 0..4, or a list.",
    )
    given: Annotated[dict[str, _Parameter], BeforeValidator(as_mapping)] = Field(
        {},
        alias="with",
        description="Values of the other parameters; $(i+1 mod 5) may use those run through.",
        json_schema_extra={"type": ["object", "null"]},
    )
