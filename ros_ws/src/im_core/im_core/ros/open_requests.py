"""Requests of a node's services without an answer yet: number and age."""

from im_core import clock


class OpenRequests:
    """Requests of the services of a node, each from its arrival to its answer; in the loop alone."""

    def __init__(self) -> None:
        self._begun: dict[object, float] = {}  # in order of arrival

    def __len__(self) -> int:
        return len(self._begun)

    def begin(self) -> object:
        """Note the arrival of a request; return its ticket for :meth:`end`."""
        ticket = object()
        self._begun[ticket] = clock.monotonic()
        return ticket

    def end(self, ticket: object) -> None:
        """Note the answer to a request."""
        del self._begun[ticket]

    def oldest_s(self) -> float:
        """Return the age of the oldest request [s]; 0 without one."""
        return clock.monotonic() - next(iter(self._begun.values())) if self._begun else 0.0
