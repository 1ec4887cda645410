"""Source of a client's time: a simulated testbed may stand still until asked for time."""

from contextlib import suppress
from typing import Protocol

from im_cell.link import ClockEnd
from im_core.errors import LinkError


class TimeSource(Protocol):
    """Time of the testbed, from the clients' view."""

    @property
    def tick(self) -> int:
        """Number of the present tick, as far as known."""
        ...

    def ask(self) -> None:
        """Let a sent request be heard."""
        ...

    def ask_until(self, tick: int) -> None:
        """Let time pass until ``tick``, requested by number, so a tick beginning just now counts."""
        ...

    def close(self) -> None:
        """Leave the testbed."""
        ...


class TestbedTime:
    """Time of the simulated testbed, passing only on request if the clock factor is 0.

    Args:
        link: The testbed; closed with this object.
    """

    __test__ = False  # not a test class, whatever pytest thinks of the name

    def __init__(self, link: ClockEnd) -> None:
        self._link = link

    @property
    def tick(self) -> int:
        """Number of the present tick."""
        return self._link.tick

    def ask(self) -> None:
        """Ask for one tick."""
        self._link.request_time(1)

    def ask_until(self, tick: int) -> None:
        """Ask for time until ``tick``; of a new testbed, if the one before is gone and there is one."""
        self._link.request_until(tick)
        if not self._link.physics_alive():
            with suppress(LinkError):
                link = ClockEnd.attach(self._link.instance, 0.0)
                self._link.close()
                self._link = link
                self.ask()

    def close(self) -> None:
        """Leave the testbed."""
        self._link.close()


class FlowingTime:
    """Time passing without requests, as on real hardware."""

    tick = 0

    def ask(self) -> None:
        """Nobody need be asked."""

    def ask_until(self, tick: int) -> None:
        """Nobody need be asked."""

    def close(self) -> None:
        """Nothing to leave."""
