"""Requests on their way: who waits for which reply, and how requests are written down."""

from collections.abc import Mapping
from dataclasses import dataclass

from im_core.errors import ImError
from im_pnt.executive import Executive
from im_pnt.expand import input_place
from im_pnt.jobs import Activity, Command, Request
from im_pnt.remote import Kind, Message


@dataclass(frozen=True, slots=True)
class Waiting:
    """A request that waits for its reply.

    Attributes:
        executive: Net that asked.
        activity: Its transition in work.
        net: Net that was asked.
        node: Node of that net, empty for one of the same process.
    """

    executive: Executive
    activity: Activity
    net: str
    node: str


class RequestBook:
    """The requests that the nets of one process have asked and not yet got answered.

    Args:
        node: Name of the process' node, part of every request's name.
        epoch: Its incarnation, likewise.

    Attributes:
        prefix: Begins every request's name.
        count: Requests asked so far.
    """

    def __init__(self, node: str, epoch: int) -> None:
        self.prefix = f"{node}-{epoch:x}"
        self.count = 0
        self._waiting: dict[str, Waiting] = {}
        self._name: dict[Activity, str] = {}

    def next_name(self) -> str:
        """Returns a name for a request, unique over all processes and their restarts."""
        self.count += 1
        return f"{self.prefix}-{self.count}"

    def open(self, request_id: str, waiting: Waiting) -> None:
        """Enters a request."""
        self._waiting[request_id] = waiting
        self._name[waiting.activity] = request_id

    def close(self, request_id: str) -> None:
        """Takes a request out; a second reply, or one that comes too late, finds none."""
        waiting = self._waiting.pop(request_id, None)
        if waiting is not None:
            del self._name[waiting.activity]

    def of_activity(self, activity: Activity) -> tuple[str, Waiting] | None:
        """Returns the request of an activity, if it still waits."""
        name = self._name.get(activity)
        return None if name is None else (name, self._waiting[name])

    def get(self, request_id: str) -> Waiting | None:
        """Returns who waits for the reply to a request."""
        return self._waiting.get(request_id)

    def of_node(self, node: str) -> list[tuple[str, Waiting]]:
        """Returns the requests that wait for a node."""
        return [(name, waiting) for name, waiting in self._waiting.items() if waiting.node == node]

    def given_up(self) -> list[tuple[str, Waiting]]:
        """Returns the requests whose transition does not wait any more (its time was over)."""
        return [(name, w) for name, w in self._waiting.items() if w.activity not in w.executive.activities]

    def items(self) -> list[tuple[str, Waiting]]:
        """Returns all requests that wait."""
        return list(self._waiting.items())


def request_message(request: Request) -> Message:
    """Returns the message that carries a request to another process."""
    payload: dict[str, object] = {
        "arguments": request.arguments,
        "symbol": request.command.symbol,
        "command_arguments": request.command.arguments,
    }
    return Message(
        Kind.REQUEST,
        request.net,
        input_place(request.service),
        request.id,
        request.caller_net,
        request.caller_transition,
        request.command.id,
        payload=payload,
    )


def request_of(sender: str, message: Message) -> Request:
    """Returns the request that a message carries."""

    def mapping(key: str) -> dict[str, object]:
        value = message.payload.get(key)
        return value if isinstance(value, dict) else {}

    command = Command(message.command_id, str(message.payload.get("symbol", "")), mapping("command_arguments"))
    return Request(
        message.request_id,
        message.net,
        message.place.removeprefix("I."),
        sender,
        message.caller_net,
        message.caller_transition,
        command,
        mapping("arguments"),
    )


def cancel_message(request_id: str, net: str, caller_net: str) -> Message:
    """Returns the message that tells a process that a request is not wanted any more."""
    payload: Mapping[str, object] = {"cancel": True}
    return Message(Kind.REQUEST, net, "", request_id, caller_net, payload=payload)


def cancelled_by(net: str) -> ImError:
    """Returns why a request ends early that its caller cancelled."""
    return ImError(f"cancelled by net {net}", code="cancelled", net=net)
