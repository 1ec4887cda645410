"""The whole of a net file, and the JSON schema for editors."""

import json
from typing import Annotated, Self

import pydantic
from pydantic import BeforeValidator, Field
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from im_pnt.model.expand import INPUT_SEMAPHORE, OUTPUT_SEMAPHORE
from im_pnt.netfile.schema.commands import CommandFile, ServiceFile
from im_pnt.netfile.schema.interrupts import InterruptFile
from im_pnt.netfile.schema.names import NAME
from im_pnt.netfile.schema.places import PlaceFile
from im_pnt.netfile.schema.scalars import as_arcs
from im_pnt.netfile.schema.templates import TemplateFile, UseFile
from im_pnt.netfile.schema.transitions import TransitionFile
from im_pnt.netfile.schema.values import (
    FilePart,
    Given,
    Name,
    Named,
    OneOrMore,
    PlaceName,
    Text,
    TextForm,
    Texts,
    Weight,
)

_COORDINATION = (INPUT_SEMAPHORE, OUTPUT_SEMAPHORE)
_REMOTE = TextForm(rf"{NAME}\.{NAME}", "is not of the form net.place")


class AssumptionFile(FilePart):
    """Assumption on other nets, proved where the nets are known."""

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


def _as_uses(value: object) -> object:
    """Wrap a single use into a list."""
    return [value] if isinstance(value, dict) else value


class FragmentFile(FilePart):
    """File for inclusion in others; the sections are checked in the assembled net."""

    include: Texts = Field(
        (), description="Files with further places, services, transitions and templates; paths from this file."
    )
    parameters: Annotated[dict[str, Weight], Named(), BeforeValidator(as_arcs)] = Field(
        {},
        description="Values that the cell gives, as arms, lights, cameras; $(arms) in the file is the list of them. "
        "With a number ({arms: 2}), so many are needed; else one.",
    )
    templates: Annotated[dict[str, TemplateFile], Named()] = Field(
        {},
        description="Parts that are written once and copied by 'use'; $(i) in them is the value of parameter i, "
        "$(i+1 mod n) is reckoned.",
    )
    use: Annotated[tuple[UseFile, ...], OneOrMore(), BeforeValidator(_as_uses)] = Field(
        (), description="Copies of templates."
    )
    interrupts: Annotated[dict[str, InterruptFile], Named()] = Field(
        {}, description="Conditions that end actions early, and what is done then, by name."
    )
    places: object = None
    services: object = None
    commands: object = None
    rest: object = None
    transitions: object = None


class NetFile(FragmentFile):
    """Net: places, transitions, and the actions of the firings. docs/nets.md explains the format with an example."""

    net: Name = Field(description="Name by which commands and other nets refer to this net.")
    description: Text = Field("", description="One line for people.")
    former: Given[Name] = Field(
        None, description="Net of which this is a former version, which only ends its commands; a machine writes it."
    )
    escalate: Given[PlaceName] = Field(
        None, description="Place for tokens of failed actions whose transition has no on_failure."
    )
    places: Annotated[dict[str, PlaceFile], Named(_COORDINATION, ours=False, qualified=True)] = Field(
        {}, description="Places by name: nothing, the tokens of the initial marking, or the keys of a place."
    )
    services: Annotated[dict[str, ServiceFile], Named()] = Field(
        {}, description="Services that other nets may request, by name."
    )
    commands: Annotated[dict[str, CommandFile], Named()] = Field(
        {}, description="Declarations of commands, by the symbol that begins each; others take any arguments."
    )
    assume: Annotated[dict[str, AssumptionFile], Named()] = Field(
        {}, description="Assumptions about other nets, by remote place or service of this one."
    )
    at_once: Weight = Field(1, description="Requests to its services that are served at once; others wait.")
    rest: Given[Texts] = Field(
        None,
        description="Places that may hold tokens while the net waits for a symbol or a request; "
        "without it, those marked initially.",
    )
    transitions: Annotated[dict[str, TransitionFile], Named(ours=False, qualified=True)] = Field(
        {}, description="Transitions by name."
    )


class _Schema(GenerateJsonSchema):
    """Schema without titles, which repeat the names, and without empty defaults."""

    def field_title_should_be_set(self, schema: object) -> bool:
        return False

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        described = super().default_schema(schema)
        return {key: value for key, value in described.items() if key != "default"}


def schema_text() -> str:
    """Return the JSON schema (draft 2020-12) of net files, for editors."""
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:im:pnt:net.schema.json",
        "title": "Petri net transducer",
        **NetFile.model_json_schema(schema_generator=_Schema),
    }
    return json.dumps(schema, indent=2) + "\n"
