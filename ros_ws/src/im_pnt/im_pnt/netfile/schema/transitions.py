"""Transitions of a net file, with the input symbols."""

from typing import Annotated, Literal, Self

import pydantic
from pydantic import BeforeValidator, Field, WithJsonSchema

from im_pnt.model.net import LARGEST
from im_pnt.netfile.schema.actions import AwaitFile, GoalFile, RequestFile, ServiceCallFile, TopicFile
from im_pnt.netfile.schema.delays import DelayFile
from im_pnt.netfile.schema.scalars import WrongKeyError, as_whole, shown
from im_pnt.netfile.schema.values import (
    COUNT,
    FUNCTION,
    NAME_FORM,
    Arcs,
    Fields,
    FilePart,
    Function,
    Given,
    Name,
    Names,
    NotNegative,
    NumberWithin,
    Positive,
    Text,
    TextForm,
    Texts,
    Truth,
)

ACTIONS = ("action", "service", "goal", "topic", "await", "request")
"""Keys of which a transition may have one."""

_EFFECTS = (*ACTIONS, "result", "store")
"""Keys by which a transition does something that can fail."""

_NEED_ACTION = ("on_failure", "on_doubt", "timeout", "tries", "success", "strategy", "acts_on", "says")
MOST_TRIES = 100


def _as_servers(value: object) -> int:
    """Read a number of servers; ``inf`` is the largest."""
    if value == "inf":
        return LARGEST
    try:
        return as_whole(value)
    except ValueError as error:
        raise ValueError(f"{shown(value)} is neither a whole number nor inf") from error


class StrategyFile(FilePart):
    """Learned probability of success."""

    successes: Positive = Field(1.0, description="Successes counted before the first run.")
    failures: Positive = Field(1.0, description="Failures counted before the first run.")
    decay: Annotated[float, NumberWithin(gt=0.0, le=1.0)] = Field(
        1.0, description="Factor on the counts of all contending strategies at each outcome; 1 forgets nothing."
    )
    context: str = Field(
        "",
        max_length=200,
        description="Text with ${arguments.NAME} in it; what is learned in one context is not used in another.",
    )
    name: Name | Literal[""] = Field(
        "", description="Under which experience is kept; transitions that do the same share a name."
    )


class SymbolFile(FilePart):
    """Symbol of the input tape: the name, or the keys."""

    short_forms = (NAME_FORM.schema(),)

    name: Name = Field(description="The symbol.")
    of: Given[Literal["command", "nobody"]] = Field(
        None,
        description="command: the symbol belongs to a command under way, and waits for one that reads it; nobody: it "
        "begins no command; without this key, it begins one where no token carries a command.",
    )
    expires: Given[NotNegative] = Field(
        None,
        description="Time for which it waits to be read [s]; 0: it does not wait when nothing else happens any more.",
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return value if isinstance(value, dict) else {"name": value}


class TransitionFile(FilePart):
    """Transition: takes the tokens of 'in', does the action, then gives the tokens of 'out'."""

    model_config = pydantic.ConfigDict(
        json_schema_extra={
            "dependentSchemas": {
                **{key: {"anyOf": [{"required": [effect]} for effect in _EFFECTS]} for key in _NEED_ACTION},
                "servers": {"anyOf": [{"required": [key]} for key in (*_EFFECTS, "delay")]},
                "arguments": {"required": ["use"]},
                **{
                    action: {"not": {"anyOf": [{"required": [other]} for other in ACTIONS if other != action]}}
                    for action in ACTIONS
                },
            }
        }
    )

    title: Text = Field("", description="Name for people, shown beside its own.")
    use: Given[Text] = Field(
        None,
        description="Template with ports that it stands for: in, out and on_failure name the places of the ports, in "
        "their order, and 'arguments' gives what the template takes; it has no other keys, but 'with'.",
    )
    arguments: Fields = Field({}, description="Of 'use': values of the template's arguments and parameters.")
    scopes: Annotated[object, WithJsonSchema({"type": ["string", "array", "object"]})] = Field(
        None,
        alias="with",
        description="Scopes around it, the outermost first: templates with three ports in 'in', two in 'out' and one "
        "in 'on_failure', by name, or by name with arguments.",
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
            TextForm(
                rf"\s*(not\s+)?({FUNCTION}|\$\{{.*\}})\s*",
                "is not a name or ${...}, nor 'not' and one of these; an expression stands in ${ }",
                like_truth=True,
            ),
        ]
    ] = Field(
        None,
        description="Enabling function by its registered name, or ${...}; 'not' and one of these; or 'otherwise': none "
        "of the other guards at its places holds.",
    )
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
    says: Text = Field(
        "",
        description="What its action does, as a verb with its object, for progress and for its failure ('could not "
        "...'); ${...} in it is a value of arguments.",
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
    tries: Annotated[int, Field(ge=1, le=MOST_TRIES), BeforeValidator(as_whole)] = Field(
        1, description="How often the action is tried before its tokens go to on_failure."
    )
    servers: Given[
        Annotated[
            int,
            Field(ge=1, le=LARGEST),
            BeforeValidator(_as_servers),
            WithJsonSchema({"anyOf": [COUNT | {"minimum": 1}, {"const": "inf"}]}),
        ]
    ] = Field(
        None,
        description="How many of its tokens are worked on at once; inf: all. Without this key all with an action, "
        "and one with a delay alone.",
    )
    cancels: Given[Text] = Field(
        None,
        description="Transition whose running action, of the same command, it asks to end early; it fires only while "
        "that action runs. It has no action itself.",
    )
    keeps_failure: Truth = Field(
        False,
        description="Whether its output tokens carry the failure of its input tokens; where its own action fails, too, "
        "both are told.",
    )
    retry_of: Given[Text] = Field(
        None, description="Transition whose further try it is, and as whose answer its own counts; 'tries' writes it."
    )
    delay: Given[DelayFile] = Field(
        None,
        description="Time of the action in simulation and analysis; of a transition without action, the time for "
        "which it must be enabled before it fires [s].",
    )
    success: Annotated[float, NumberWithin(ge=0.0, le=1.0)] = Field(
        1.0, description="Probability that the action succeeds, in simulation and analysis."
    )
    weight: Positive = Field(
        1.0, description="How often it is taken among contending transitions, relative to the others."
    )
    strategy: Given[StrategyFile] = Field(
        None, description="Its probability of success is learned from outcomes, and weighs in the choice."
    )
    priority: Annotated[int, Field(ge=-LARGEST, le=LARGEST), BeforeValidator(as_whole)] = Field(
        0, description="Larger goes first among contending transitions."
    )

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        given = {type(self).model_fields[name].alias or name for name in self.model_fields_set}
        actions = [key for key in ACTIONS if key in given]
        if len(actions) > 1:
            raise ValueError(f"has {' and '.join(actions)}; one action is allowed")
        if "cancels" in given:
            for key in (*_EFFECTS, "delay"):
                if key in given:
                    raise WrongKeyError(
                        ("cancels",), f"does not go together with '{key}'; cancel in a transition of its own"
                    )
        if "arguments" in given and "use" not in given:
            raise WrongKeyError(
                ("arguments",), "is for 'use'; those of a request stand in it: {to: net.service, arguments: {...}}"
            )
        if not given & set(_EFFECTS):
            for key in _NEED_ACTION:
                if key in given:
                    raise WrongKeyError((key,), f"needs an action that can fail ({', '.join(_EFFECTS)})")
            if "servers" in given and "delay" not in given:
                raise WrongKeyError(("servers",), f"needs something that takes time ({', '.join(_EFFECTS)}, delay)")
        return self
