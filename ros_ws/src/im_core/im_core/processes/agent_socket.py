"""Orders of an agent and reports of the tasks, through a socket of which no other process has an end.

The agent makes a pair of sockets for each process that it starts, and the process inherits one of them. Other users of
the host and participants of DDS reach neither.
"""

import json
import os
import socket
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Self

from im_core.text.bounded_json import read_json

#: The environment variable that tells a process the file descriptor of its end.
VARIABLE = "IM_AGENT_SOCKET"

_LARGEST = 1 << 18
_LONGEST_DETAIL = 10_000


@dataclass(frozen=True)
class TaskIncarnation:
    """Present incarnation of a task, as told by an agent.

    Attributes:
        incarnation: Number that the task drew when it started; 0: none is known yet.
        pid: Its process, where that is of the same host as the agent; else 0.
        starting: Whether the task has told that it is loaded or configured, and not yet that it is ready.
    """

    incarnation: int
    pid: int
    starting: bool


@dataclass(frozen=True)
class AgentOrder:
    """Order of an agent to the processes.

    Attributes:
        phase: The last phase of the start-up that all tasks may enter, of :class:`.StartupPhase`.
        incarnations: The incarnations of all tasks of the machine, by name.
    """

    phase: int
    incarnations: dict[str, TaskIncarnation]

    def text(self) -> str:
        """The order as JSON; see :meth:`AgentSocket.orders`."""
        return _json(self)


@dataclass(frozen=True)
class TaskReport:
    """Report of a task to the agent; the first fields as of ``im_msgs/msg/TaskStatus``.

    Attributes:
        task, incarnation, phase, detail: As there.
        nets: The digests of its nets, by name.
        turns: How many callbacks it has begun.
        requests: How many requests of its services wait for an answer.
        oldest_s: Age of the oldest of them [s].
        cpu_s: CPU time of its process and the children of that, told by the agent [s].
        memory_mib: Their private memory, told by the agent [MiB].
        refused: How many requests of its services were answered without success.
    """

    task: str
    incarnation: int
    phase: int
    detail: str
    nets: dict[str, str] = field(default_factory=dict)
    turns: int = 0
    requests: int = 0
    oldest_s: float = 0.0
    cpu_s: float = 0.0
    memory_mib: float = 0.0
    refused: int = 0


class AgentSocket:
    """One end of the socket between an agent and a process."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    @classmethod
    def pair(cls) -> tuple[Self, int]:
        """Make a new socket: the agent's end, and the file descriptor of the other, for a child."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        return cls(ours), theirs.detach()

    @classmethod
    def inherited(cls) -> Self | None:
        """Return the socket end given by an agent to the process, None if none; child processes get none."""
        descriptor = os.environ.pop(VARIABLE, "")
        if not descriptor:
            return None
        return cls.of(int(descriptor))

    @classmethod
    def of(cls, descriptor: int) -> Self:
        """Take over a file descriptor, and return the socket end made of the descriptor."""
        os.set_inheritable(descriptor, False)
        return cls(socket.socket(fileno=descriptor))

    def close(self) -> None:
        """Close the socket end of the process."""
        self._end.close()

    def send(self, text: str) -> bool:
        """Send a message if there is room now, without waiting; return whether there was room."""
        try:
            self._end.send(text.encode(), socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except OSError:  # the other process is stopped, and its queue full; or it has ended
            return False
        return True

    def report(self, report: TaskReport) -> None:
        """Send a report to the agent; without room a report is dropped, and repeated with the next heartbeat."""
        self.send(_json(replace(report, detail=report.detail[:_LONGEST_DETAIL])))

    def reports(self) -> Iterator[TaskReport]:
        """Yield the reports received so far, without waiting.

        Raises:
            DataError: One is none.
        """
        while True:
            try:
                told = self._end.recv(_LARGEST, socket.MSG_DONTWAIT)
            except OSError:  # nothing more has come, or the process has ended
                return
            if not told:
                return
            yield read_json(TaskReport, told.decode(), "the report of a task")

    def orders(self) -> Iterator[AgentOrder]:
        """Yield each order of the agent, waiting between orders, until the agent has ended; for a separate thread."""
        while told := self._end.recv(_LARGEST):
            yield read_json(AgentOrder, told.decode(), "the order of an agent")


def _json(value: AgentOrder | TaskReport) -> str:
    return json.dumps(asdict(value))
