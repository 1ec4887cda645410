"""Interrupts of a net file: rules for the time during an action."""

from typing import Annotated, Literal, Self

import pydantic
from pydantic import BeforeValidator, Field, WithJsonSchema

from im_pnt.netfile.schema.actions import WatchedFile
from im_pnt.netfile.schema.delays import DelayFile
from im_pnt.netfile.schema.scalars import WrongKeyError
from im_pnt.netfile.schema.values import FilePart, Given, OneOrMore, Text, Texts


def _as_steps(value: object) -> object:
    """Wrap a single step into a list."""
    return [value] if isinstance(value, dict) else value


class InterruptFile(FilePart):
    """Interrupt: a condition that ends an action early, and the steps after that."""

    during: Texts = Field(description="Transitions with the actions or the subnets that it interrupts.")
    watch: Given[WatchedFile] = Field(None, description="Topic of its condition; every message is looked at.")
    condition: Given[Text] = Field(
        None,
        alias="if",
        description="Condition ${...} over message.FIELD of the topic, arguments and data, or without a topic any "
        "guard; without it every message of the topic interrupts.",
    )
    do: Annotated[
        tuple[Annotated[object, WithJsonSchema({"type": "object"})], ...], OneOrMore(), BeforeValidator(_as_steps)
    ] = Field((), description="What is done then, in order: the keys of a transition with an action, or with a delay.")
    then: Literal["restart", "skip", "fail", "continue"] = Field(
        description="How it goes on: begin the action again, go on as if it had ended well, or as if it had failed; "
        "continue: do not end the action at all, and do this beside it."
    )
    says: Text = Field("", description="Its name for people, in the failure: 'interrupted by ...'.")
    delay: Given[DelayFile] = Field(
        None, description="Time until the condition comes, in simulation and analysis; without it never."
    )

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.watch is None and self.condition is None:
            raise ValueError("has neither 'watch' nor 'if': nothing would tell when it interrupts")
        if self.watch is None and self.delay is not None:
            raise WrongKeyError(("delay",), "is the time until a message of 'watch' comes, and there is none")
        if self.then == "continue" and not self.do:
            raise WrongKeyError(("then",), "'continue' needs something to do")
        return self
