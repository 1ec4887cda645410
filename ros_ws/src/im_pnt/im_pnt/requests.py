"""Requests on their way: who waits for which reply, and what to do when one side is gone."""

from dataclasses import dataclass

from im_core.errors import ImError
from im_pnt.executive import Executive
from im_pnt.jobs import Activity


@dataclass(frozen=True, slots=True)
class Waiting:
    """A request that waits for its reply.

    Attributes:
        executive: Net that asked.
        activity: Its transition in work.
        net: Net that was asked.
        node: Node of that net, empty for one of the same process.
        since: When it was asked (monotonic) [s].
    """

    executive: Executive
    activity: Activity
    net: str
    node: str
    since: float


class RequestBook:
    """The requests that the nets of one process have asked and not yet got answered.

    Args:
        node: Name of the process' node, part of every request's name.
        epoch: Its incarnation, likewise.
    """

    def __init__(self, node: str, epoch: int) -> None:
        self._prefix = f"{node}-{epoch:x}"
        self._count = 0
        self._waiting: dict[str, Waiting] = {}

    def open(self, waiting: Waiting) -> str:
        """Enters a request and gives it a name."""
        self._count += 1
        request_id = f"{self._prefix}-{self._count}"
        self._waiting[request_id] = waiting
        return request_id

    def answer(self, request_id: str, error: ImError | None, results: dict[str, object]) -> bool:
        """Ends a request with its reply.

        Returns:
            Whether anybody waited for it; a second reply, or one that comes too late, finds nobody.
        """
        waiting = self._waiting.pop(request_id, None)
        if waiting is None:
            return False
        waiting.executive.ended(waiting.activity, error, results)
        return True

    def of_activity(self, activity: Activity) -> tuple[str, Waiting] | None:
        """Returns the request of an activity, if it still waits."""
        return next(((name, w) for name, w in self._waiting.items() if w.activity is activity), None)

    def of_node(self, node: str) -> list[str]:
        """Returns the requests that wait for a node."""
        return [name for name, waiting in self._waiting.items() if waiting.node == node]

    def given_up(self) -> list[tuple[str, Waiting]]:
        """Takes out the requests whose transition does not wait any more (its time was over)."""
        stale = [(name, w) for name, w in self._waiting.items() if w.activity not in w.executive.activities]
        for name, _ in stale:
            del self._waiting[name]
        return stale

    def items(self) -> list[tuple[str, Waiting]]:
        """Returns all requests that wait."""
        return list(self._waiting.items())
