"""Actions of transitions in a net file."""

from typing import Annotated

import pydantic
from pydantic import Field

from im_pnt.netfile.schema.names import MAX_NAME, NAME
from im_pnt.netfile.schema.values import Fields, FilePart, Function, Given, Name, Positive, TextForm, Truth, type_form

_SERVICE = TextForm(rf"{NAME}\.{NAME}", "is not of the form net.service")

_TOKEN = r"(?:[A-Za-z_]|\{(?:node|ns|namespace)\})(?:[A-Za-z0-9_]|\{(?:node|ns|namespace)\})*"
_ARGUMENT = r"\$\{arguments\.[A-Za-z_][A-Za-z0-9_]*\}"


def _ros_name(token: str) -> TextForm:
    says = "is no name of ROS (words of letters, digits and _, not starting with a digit, with / between them)"
    return TextForm(rf"(?:~?/)?{token}(?:/{token})*", says, like_truth=True, longest=MAX_NAME)


_RosName = Annotated[str, _ros_name(_TOKEN)]
_ChosenName = Annotated[str, _ros_name(rf"(?:{_TOKEN}|{_ARGUMENT})")]


class _MessageFile(FilePart):
    name: _RosName = Field(description="Name of the service, action or topic.")
    build: Given[Function] = Field(None, description="Registered function that makes further fields.")


class _CallFile(_MessageFile):
    handle: Given[Function] = Field(None, description="Registered function that reads the answer.")
    task: Given[Name] = Field(None, description="Task that answers, whose death ends the wait.")


class TopicFile(_MessageFile):
    """A message."""

    type: Annotated[str, type_form("msg")] = Field(description="Its type, package/msg/Type.")
    message: Fields = Field({}, description="Fields of the message.")


class WatchedFile(FilePart):
    """Watched topic."""

    name: _RosName = Field(description="Name of the topic.")
    type: Annotated[str, type_form("msg")] = Field(description="Its type, package/msg/Type.")
    latched: Truth = Field(
        False, description="Whether the last message of a latched topic, published before, counts too."
    )
    silent: Given[Positive] = Field(None, description="Time without any message after which the wait fails [s].")


class AwaitFile(WatchedFile):
    """Awaited message."""

    until: Given[Annotated[str, TextForm(r"\$\{.*\}", "is not a condition ${...}")]] = Field(
        None, description="Condition on the message, answers.TRANSITION of its own transition; others are passed over."
    )
    handle: Given[Function] = Field(None, description="Registered function that reads the message.")


class ServiceCallFile(_CallFile):
    """A call of a ROS service."""

    type: Annotated[str, type_form("srv")] = Field(description="Its type, package/srv/Type.")
    request: Fields = Field({}, description="Fields of the request.")


class GoalFile(_CallFile):
    """A ROS action goal."""

    name: _ChosenName = Field(description="Name of the action; ${arguments.NAME} in it is an argument with choices.")
    type: Annotated[str, type_form("action")] = Field(description="Its type, package/action/Type.")
    goal: Fields = Field({}, description="Fields of the goal.")


class RequestFile(FilePart):
    """Request to another net: net.service, or the keys."""

    short_forms = (_SERVICE.schema(),)

    to: Annotated[str, _SERVICE] = Field(description="The service, net.service.")
    arguments: Fields = Field({}, description="Arguments of the request.")
    build: Given[Function] = Field(None, description="Registered function that makes further arguments.")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        return value if isinstance(value, dict) else {"to": value}
