"""Actions of transitions, between the input and output tokens."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from im_core.errors import ImError


@dataclass(frozen=True, slots=True)
class FunctionAction:
    """Calls a registered function."""

    function: str

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the called functions."""
        return (self.function,)

    @property
    def is_imported(self) -> bool:
        """Whether the function is one of a user's module, ``module:function``."""
        return ":" in self.function

    def __str__(self) -> str:
        return f"function {self.function}"


@dataclass(frozen=True, slots=True)
class _Message:
    """A message to somebody in ROS.

    Attributes:
        name: Name of the service, action or topic.
        type: Its type, ``package/srv/Type``, ``package/action/Type`` or ``package/msg/Type``.
        fields: Fields of the message.
        build: Registered function that makes further fields.
    """

    name: str
    type: str
    fields: Mapping[str, object] = field(default_factory=dict)
    build: str | None = None

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the called functions."""
        return _named(self.build)


@dataclass(frozen=True, slots=True)
class _Call(_Message):
    """Message with an answer.

    Attributes:
        handle: Registered function that reads the answer.
        task: Task that answers, whose death ends the wait; None: the first part of the name, if that is a task.
    """

    handle: str | None = None
    task: str | None = None

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the called functions."""
        return _named(self.build, self.handle)


@dataclass(frozen=True, slots=True)
class ServiceAction(_Call):
    """Calls a service."""

    def __str__(self) -> str:
        return f"service {self.name}"


@dataclass(frozen=True, slots=True)
class GoalAction(_Call):
    """Sends an action goal."""

    def __str__(self) -> str:
        return f"goal {self.name}"


@dataclass(frozen=True, slots=True)
class TopicAction(_Message):
    """Publication of one message; confirmed once the middleware has taken the message."""

    def __str__(self) -> str:
        return f"topic {self.name}"


@dataclass(frozen=True, slots=True)
class AwaitAction:
    """Waits for a message of a topic.

    Attributes:
        name: Name of the topic.
        type: Its type, ``package/msg/Type``.
        latched: Whether the last message, published before the wait began, counts too.
        until: Condition ``${...}`` that a message fulfils which counts; None: any does.
        handle: Registered function that reads the message.
        silent: Time without any message after which it fails [s]; None: never.
    """

    name: str
    type: str
    latched: bool = False
    handle: str | None = None
    until: str | None = None
    silent: float | None = None

    @property
    def silence(self) -> ImError:
        """Failure of a wait on a topic that has become silent."""
        return ImError(f"no message of {self.name} came for {self.silent:g} s", code="silent", topic=self.name)

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the called functions."""
        return _named(self.handle)

    def __str__(self) -> str:
        return f"message of {self.name}"


@dataclass(frozen=True, slots=True)
class RequestAction:
    """Request for a service of another net through the coordination structure (paper, Figure 11)."""

    net: str
    service: str
    fields: Mapping[str, object] = field(default_factory=dict)
    build: str | None = None

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the called functions."""
        return _named(self.build)

    def __str__(self) -> str:
        return f"request {self.net}.{self.service}"


@dataclass(frozen=True, slots=True)
class ValuesAction:
    """Returns or stores values, and does nothing else."""

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the called functions: none."""
        return ()

    def __str__(self) -> str:
        return "values"


Action = FunctionAction | ServiceAction | GoalAction | RequestAction | TopicAction | AwaitAction | ValuesAction


def _named(*names: str | None) -> tuple[str, ...]:
    return tuple(name for name in names if name)
