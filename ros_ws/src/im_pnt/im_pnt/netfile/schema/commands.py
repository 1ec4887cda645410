"""Commands and services of a net file, and the arguments."""

from typing import Annotated, Literal, Self

import pydantic
from pydantic import BeforeValidator, Field, WithJsonSchema
from pydantic.json_schema import JsonSchemaValue

from im_core.config import FieldError
from im_pnt.model.arguments import Argument, ArgumentType
from im_pnt.model.net import LARGEST
from im_pnt.netfile.schema.scalars import WrongKeyError, as_list, as_number, as_plain, as_whole
from im_pnt.netfile.schema.values import COUNT, FilePart, Given, Named, PlaceName, Text, Texts


def _length(value: object) -> tuple[int, int]:
    """Read a length: ``9``, or ``[1, 9]``."""
    numbers = [as_whole(each) for each in value] if isinstance(value, list) else [as_whole(value)] * 2
    if len(numbers) != 2 or not 0 <= numbers[0] <= LARGEST or not 0 <= numbers[1] <= LARGEST:
        raise ValueError(f"{numbers} is no length: a number >= 0, or [least, most], is needed")
    if numbers[1] < numbers[0]:
        raise ValueError(f"{numbers}: most {numbers[1]} is less than least {numbers[0]}")
    return numbers[0], numbers[1]


def _choices(value: object) -> list[object]:
    return [as_plain(each) for each in as_list(value)]


_Limit = Annotated[float, Field(allow_inf_nan=False, strict=True), BeforeValidator(as_number)]
_ANY: JsonSchemaValue = {"type": ["string", "number", "boolean", "array", "object", "null"]}


class ArgumentFile(FilePart):
    """Allowed values of an argument."""

    type: Literal["boolean", "integer", "number", "string", "booleans", "integers", "numbers", "strings", "object"] = (
        Field(description="Type of its value; types in the plural are lists, object is any JSON.")
    )
    unit: Text = Field("", description="Unit of its numbers, as m or rad/s.")
    minimum: Given[_Limit] = Field(None, description="Least number, also of each element of a list.")
    maximum: Given[_Limit] = Field(None, description="Greatest number, also of each element of a list.")
    choices: Annotated[tuple[object, ...], BeforeValidator(_choices), WithJsonSchema({"type": "array"})] = Field(
        (), description="Allowed values, also of each element of a list."
    )
    length: Given[
        Annotated[
            tuple[int, int],
            pydantic.PlainValidator(_length),
            WithJsonSchema({"anyOf": [COUNT, {"type": "array", "items": COUNT, "minItems": 2, "maxItems": 2}]}),
        ]
    ] = Field(None, description="Elements of a list, or characters of a text: a number, or [least, most].")
    default: Annotated[object, BeforeValidator(as_plain), WithJsonSchema(_ANY)] = Field(
        None, description="Its value where none is given; without this key, the argument is required."
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

    def argument(self, name: str) -> Argument:
        """Return the argument of a name."""
        required = "default" not in self.model_fields_set
        kind, limits = ArgumentType(self.type), (self.minimum, self.maximum)
        return Argument(name, kind, self.unit, *limits, self.choices, self.length, required, self.default, self.help)


Arguments = Annotated[dict[str, ArgumentFile], Named()]


class CommandFile(FilePart):
    """Command: a symbol beginning a command."""

    description: Text = Field("", description="One line for people.")
    arguments: Arguments = Field({}, description="Arguments by name; others are refused.")
    needs: Texts = Field(
        (), description="Resources that it holds while it is under way; ${arguments.NAME} in them is an argument."
    )
    busy: Literal["wait", "refuse"] = Field("wait", description="Wait, or be refused, while others hold these.")
    priority: Annotated[int, Field(ge=-10, le=10), BeforeValidator(as_whole)] = Field(
        0, description="Larger goes first, where several wait for the same."
    )


class ServiceFile(FilePart):
    """A service offered through a coordination structure."""

    entry: PlaceName = Field(description="Place marked when a request is accepted.")
    done: PlaceName = Field(description="Place that means success.")
    failed: PlaceName = Field(description="Place that means failure.")
    arguments: Given[Arguments] = Field(
        None, description="Arguments by name; others are refused. Without this key, any are allowed."
    )
    acts_on: Given[Texts] = Field(
        None, description="Resources that it acts on, held by its caller; ${arguments.NAME} in them is an argument."
    )

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if len({self.entry, self.done, self.failed}) < 3:
            raise ValueError("entry, done and failed must be three different places")
        return self
