"""What a net works for: commands of the tape and requests of other nets; and the actions it has running for them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from im_core.errors import ImError
from im_pnt.net import Action


@dataclass(frozen=True, slots=True)
class Command:
    """A command of the input tape; requests made for it carry it along.

    Attributes:
        id: Number of the command, 0 where there is none.
        symbol: Its symbol.
        arguments: What it was given.
    """

    id: int = 0
    symbol: str = ""
    arguments: dict[str, object] = field(default_factory=dict)


NO_COMMAND = Command()


@dataclass(frozen=True, slots=True)
class Request:
    """A request to a service of a net (paper, Figure 11).

    Attributes:
        id: Name of the request, unique over all processes and their restarts.
        net: Net that is asked.
        service: Its service.
        caller_node: Node of the caller; empty for a net of the same process.
        caller_net: Net that asks.
        caller_transition: Transition that waits for the reply.
        command: Command it is made for.
        arguments: What the service is given.
    """

    id: str
    net: str
    service: str
    caller_node: str
    caller_net: str
    caller_transition: str
    command: Command
    arguments: dict[str, object]


@dataclass(frozen=True, slots=True)
class CommandResult:
    """How a command ended.

    Attributes:
        success: Whether the net emitted ``<symbol>_done``.
        error: Why not.
        results: What its actions left in ``ctx.result``.
    """

    success: bool
    error: ImError | None
    results: dict[str, object]


@dataclass(slots=True, eq=False)
class Job:
    """A command or request in work.

    Attributes:
        command: The command.
        arguments: Arguments of the command, or of the request.
        request: The request, for a job that another net asked for.
        results: What is returned in the end; actions write it.
        replies: Results of the requests made for this job, by transition.
        last_failure: The last failure of an action done for it.
        progress: Progress 0..1, negative where unknown.
        cancelled: Whether it should come to an end early.
        closed: Whether it has ended.
        on_closed: Called once with the result.
    """

    command: Command
    arguments: dict[str, object]
    request: Request | None = None
    results: dict[str, object] = field(default_factory=dict)
    replies: dict[str, dict[str, object]] = field(default_factory=dict)
    last_failure: ImError | None = None
    progress: float = -1.0
    cancelled: bool = False
    closed: bool = False
    on_closed: Callable[[CommandResult], None] | None = None

    def close(self, error: ImError | None) -> None:
        """Ends the job, once."""
        if self.closed:
            return
        self.closed = True
        if self.on_closed is not None:
            self.on_closed(CommandResult(error is None, error, self.results))


class Lineage(NamedTuple):
    """What a token carries unseen by the net: the job it belongs to, and the failure that made it."""

    job: Job | None
    failure: ImError | None


NO_LINEAGE = Lineage(None, None)


@dataclass(slots=True, eq=False)
class Activity:
    """An action that runs: a marked ``t.active``.

    Attributes:
        net: Net it belongs to.
        transition: Transition as written.
        index: Index of ``t.start`` in the expanded net.
        action: What is done.
        lineage: What the tokens taken carried.
        began: When it began (monotonic) [s].
        deadline: When it counts as failed (monotonic) [s], None: never.
        objects: Data objects that must be valid when it has succeeded.
        cancelled: Whether it was asked to end early.
        checked: Whether the data objects have been looked at.
        on_cancel: Called when it is asked to end early.
    """

    net: str
    transition: str
    index: int
    action: Action
    lineage: Lineage
    began: float
    deadline: float | None
    objects: tuple[str, ...] = ()
    cancelled: bool = False
    checked: bool = False
    on_cancel: list[Callable[[], None]] = field(default_factory=list)

    def cancel(self) -> list[Exception]:
        """Asks the action to end early, once; how it ends still decides what is marked.

        Returns:
            What its callbacks raised.
        """
        if self.cancelled:
            return []
        self.cancelled = True
        raised: list[Exception] = []
        for callback in self.on_cancel:
            try:
                callback()
            except Exception as error:  # foreign code must not keep the others from being told
                raised.append(error)
        return raised
