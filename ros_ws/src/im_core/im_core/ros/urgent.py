"""Priority of stops: requests to cancel, pause or stop are taken before callbacks that wait."""

from collections.abc import Callable

from rclpy.exceptions import InvalidHandle

from im_core import clock

#: How often urgent readers are looked into while callbacks run [s]; a look costs some microseconds a reader.
LOOK_S = 0.01


class UrgentReaders:
    """Readers of stops of the nodes in one loop; for use in the loop alone.

    The events executor runs callbacks in the order of arrival. A loop with work waiting looks into these readers
    before the next callback; the executor later finds nothing left to take.
    """

    def __init__(self) -> None:
        self._takes: list[Callable[[], None]] = []
        self._due, self._looking = 0.0, False

    def add(self, take: Callable[[], None]) -> None:
        """Add a reader; ``take`` handles everything waiting in it."""
        self._takes.append(take)

    def join(self, others: "UrgentReaders") -> None:
        """Add the readers of another node in the same loop."""
        self._takes += others._takes

    def look(self) -> None:
        """Take the waiting requests if the last look is :data:`LOOK_S` ago; take none within such a request."""
        if self._looking or not self._takes or clock.monotonic() < self._due:
            return
        self._looking = True
        try:
            for take in tuple(self._takes):
                try:
                    take()
                except InvalidHandle:  # destroyed
                    self._takes.remove(take)
        finally:
            self._looking, self._due = False, clock.monotonic() + LOOK_S
