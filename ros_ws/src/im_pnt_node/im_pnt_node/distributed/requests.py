"""The requests that the nets of one process have asked, and that wait for their reply."""

from dataclasses import dataclass

from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import Activity


@dataclass(frozen=True, slots=True)
class Waiting:
    """A request that waits for its reply.

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
    """The requests that the nets of one process have asked and not yet got answered.

    Args:
        node: Name of the process' node, part of every request's name.
        epoch: Its incarnation, likewise.

    Attributes:
        prefix: Names the process, as long as it has its journal.
        life: Begins the name of every request: that of the process, or another one since it was found out that its
            journal has forgotten requests: what answers one of these answers no later one.
        count: Requests asked so far.
    """

    def __init__(self, node: str, epoch: int) -> None:
        self.prefix = self.life = f"{node}-{epoch:x}"
        self.count = 0
        self._waiting: dict[str, Waiting] = {}
        self._name: dict[Activity, str] = {}

    def next_name(self) -> str:
        """Returns the name of the next request, unique over all processes and their restarts."""
        return f"{self.life}-{self.count + 1}"

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
        return [(name, w) for name, w in self._waiting.items() if w.activity not in w.executor.activities]

    def items(self) -> list[tuple[str, Waiting]]:
        """Returns all requests that wait."""
        return list(self._waiting.items())
