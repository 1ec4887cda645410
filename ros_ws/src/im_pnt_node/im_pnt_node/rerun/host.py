"""The node as used by functions of nets, replaceable in a re-run."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from im_pnt.execution.executor import Executor
from im_pnt.execution.values import Objects
from im_pnt.model.net import Net

ValueT = TypeVar("ValueT")
MessageT = TypeVar("MessageT")


class HostObjects(Protocol):
    """Data objects, with the interface of :class:`im_core.ros.dom.DomClient`; every refusal raises ImError."""

    async def get(self, name: str, message_type: type[MessageT]) -> MessageT:
        """Return an object."""

    async def put(self, name: str, message: object, place: str = "") -> int:
        """Store an object; return the version."""

    async def append(self, name: str, message: object) -> int:
        """Append the sequences of a message to the sequences of an object of the type; return the version."""

    async def is_valid(self, name: str) -> bool:
        """Return whether there is a valid object of a name."""

    async def invalidate(self, name: str) -> None:
        """Declare an object invalid."""


class Host(Protocol):
    """The node, or the stand-in in a re-run.

    What a function learns from outside, it learns here; whatever else it uses must depend on its arguments only.

    Attributes:
        name: Full name of the node.
        dom: The data objects, as messages.
        values: The same as JSON data, as seen by expressions of nets.
    """

    name: str
    dom: HostObjects
    values: Objects

    @property
    def recorded(self) -> bool:
        """Whether the mission is being recorded: a function may hold values read before the recording.

        Who keeps something reads it all the same then, so that the recording has it wherever it begins.
        """

    def last(self, topic: str) -> Any:
        """Return the last message of a topic followed by the node, None before the first."""

    def parameter(self, name: str) -> Any:
        """Return a parameter of the node."""

    def incarnation(self, task: str) -> int | None:
        """Return the present incarnation of a task, None before the first heartbeat."""

    async def ask(self, service_type: type, service: str, request: object, task: str, what: str) -> Any:
        """Return the answer of a service without an effect; ask again where an answer was lost.

        Args:
            service_type: Its type.
            service: Its name.
            request: The request.
            task: The task that answers.
            what: What is asked for, for the message of the error.

        Raises:
            ImError: It does not answer.
        """

    async def pause(self, seconds: float) -> None:
        """Let wall time pass [s]."""

    def noted(self, key: str, compute: Callable[[], ValueT]) -> ValueT:
        """Return a value computed from the world outside, such as a time or a folder; JSON data.

        When a mission is run again, this is what was recorded, and nothing is computed.
        """

    async def noted_apart(self, key: str, compute: Callable[..., ValueT], *arguments: object) -> ValueT:
        """Return a value computed from the world outside, in a separate thread, for slow work."""

    def warn(self, text: str) -> None:
        """Write a line to the log."""

    def executor(self, net: str) -> Executor:
        """Return a net of the node in execution."""

    def nets(self) -> Sequence[Net]:
        """Return the nets of the node, as written."""
