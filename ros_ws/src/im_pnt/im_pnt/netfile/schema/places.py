"""Places of a net file, and the data objects."""

from typing import Annotated, Literal, Self

import pydantic
from pydantic import Field

from im_pnt.netfile.schema.scalars import WrongKeyError
from im_pnt.netfile.schema.values import COUNT, ONE_TEXT, Count, FilePart, Given, Text, Texts, Truth, Weight, type_form


class ObjectFile(FilePart):
    """Data object: the name, or the keys."""

    short_forms = (ONE_TEXT,)

    name: Text = Field(description="Its name.")
    type: Given[Annotated[str, type_form("msg")]] = Field(None, description="Its type, package/msg/Type.")
    scope: Literal["command", "global"] = Field(
        "command", description="command: each command has its own; global: there is one for the machine."
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return value if isinstance(value, dict) else {"name": value}


class PlaceFile(FilePart):
    """Place: nothing, the tokens, or the keys."""

    model_config = pydantic.ConfigDict(json_schema_extra={"dependentRequired": {"on_invalid": ["data_object"]}})
    short_forms = (COUNT,)

    title: Text = Field("", description="Name for people, shown beside its own.")
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
        None, description="Whether its tokens carry no command; without this key, it is derived."
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
