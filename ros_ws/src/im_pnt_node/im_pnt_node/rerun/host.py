"""What functions of nets use of the node that runs them, so that they can be run again without it."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from im_pnt.execution.executor import Executor
from im_pnt.model.net import Net

ValueT = TypeVar("ValueT")
MessageT = TypeVar("MessageT")


class HostObjects(Protocol):
    """Data objects, as :class:`im_core.ros.dom.DomClient` has them; all raise ImError where they are refused."""

    async def get(self, name: str, message_type: type[MessageT]) -> MessageT:
        """Returns an object."""

    async def put(self, name: str, message: object, place: str = "") -> int:
        """Stores an object; returns its version."""

    async def append(self, name: str, message: object) -> int:
        """Appends to the sequences of an object those of a message of its type; returns its version."""

    async def is_valid(self, name: str) -> bool:
        """Whether there is a valid object of that name."""

    async def invalidate(self, name: str) -> None:
        """Declares an object invalid."""


class Host(Protocol):
    """The node, or what stands for it when its nets are run again.

    What a function learns from outside, it learns here; whatever else it uses must depend on its arguments only.

    Attributes:
        name: Full name of the node.
        dom: The data objects.
    """

    name: str
    dom: HostObjects

    @property
    def recorded(self) -> bool:
        """Whether the mission is being recorded: what a function keeps of what it read may be from before that.

        Who keeps something reads it all the same then, so that the recording has it wherever it begins.
        """

    def last(self, topic: str) -> Any:
        """Returns the last message of a topic that the node follows, None before the first."""

    def parameter(self, name: str) -> Any:
        """Returns a parameter of the node."""

    def life(self, task: str) -> int | None:
        """Returns the present life of a task, None before its first heartbeat was heard."""

    async def ask(self, service_type: type, service: str, request: object, task: str, what: str) -> Any:
        """Returns the answer of a service that has no effect, asked again where an answer was lost.

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
        """Lets wall time pass [s]."""

    def noted(self, key: str, compute: Callable[[], ValueT]) -> ValueT:
        """Returns what is computed from the world outside, such as a time or a folder; JSON data.

        When a mission is run again, this is what was recorded, and nothing is computed.
        """

    async def noted_apart(self, key: str, compute: Callable[..., ValueT], *arguments: object) -> ValueT:
        """Does the same in a thread of its own, for what takes long."""

    def warn(self, text: str) -> None:
        """Writes a line to the log."""

    def executor(self, net: str) -> Executor:
        """Returns a net of the node in execution."""

    def nets(self) -> Sequence[Net]:
        """Returns the nets of the node, as written."""
