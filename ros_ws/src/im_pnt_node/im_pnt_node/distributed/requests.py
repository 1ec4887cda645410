"""The open requests of the nets of one process."""

from dataclasses import dataclass

from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import Activity


@dataclass(frozen=True, slots=True)
class Waiting:
    """Request with a missing reply.

    Attributes:
        executor: Net that asked.
        activity: Its transition in work.
        net: Net that was asked.
        node: Node of that net, empty for one of the same process.
    """

    executor: Executor
    activity: Activity
    net: str
    node: str


class RequestBook:
    """Book of the requests of one process without an answer.

    Args:
        node: Name of the process' node, part of every request's name.
        epoch: Its incarnation, likewise.

    Attributes:
        prefix: Names the process, as long as it has its journal.
        incarnation: Begins the name of every request: that of the process, or another one since it was found out that
            its journal has forgotten requests: what answers one of these answers no later one.
        count: Requests asked so far.
    """

    def __init__(self, node: str, epoch: int) -> None:
        self.prefix = self.incarnation = f"{node}-{epoch:x}"
        self.count = 0
        self._waiting: dict[str, Waiting] = {}
        self._name: dict[Activity, str] = {}

    def next_name(self) -> str:
        """Return the name of the next request, unique over all processes and the restarts."""
        return f"{self.incarnation}-{self.count + 1}"

    def open(self, request_id: str, waiting: Waiting) -> None:
        """Enter a request."""
        self._waiting[request_id] = waiting
        self._name[waiting.activity] = request_id

    def close(self, request_id: str) -> None:
        """Take out a request; a second or late reply finds none."""
        waiting = self._waiting.pop(request_id, None)
        if waiting is not None:
            del self._name[waiting.activity]

    def of_activity(self, activity: Activity) -> tuple[str, Waiting] | None:
        """Return the waiting request of an activity, if there is one."""
        name = self._name.get(activity)
        return None if name is None else (name, self._waiting[name])

    def get(self, request_id: str) -> Waiting | None:
        """Return the waiting entry of a request."""
        return self._waiting.get(request_id)

    def of_node(self, node: str) -> list[tuple[str, Waiting]]:
        """Return the requests to a node."""
        return [(name, waiting) for name, waiting in self._waiting.items() if waiting.node == node]

    def given_up(self) -> list[tuple[str, Waiting]]:
        """Return the requests without a waiting transition (the time was over)."""
        return [(name, w) for name, w in self._waiting.items() if not w.executor.runs(w.activity)]

    def items(self) -> list[tuple[str, Waiting]]:
        """Return all waiting requests."""
        return list(self._waiting.items())
