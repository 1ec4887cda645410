"""Owners whose next request is awaited before simulated time goes on for the others."""

import math
from collections.abc import Mapping

from im_core import clock
from im_mcs.state import State


class AwaitedOwners:
    """Owners of groups that do nothing: they have been answered, and have not said yet what is next.

    What an owner does between two requests, such as planning a path, takes no simulated time at clock factor 0 while
    nobody else moves. Where another group moves it would take as much as the computer happens to simulate meanwhile:
    some seconds. So time stands for them too, but not for ever: an owner may not want anything more for a long while.

    Args:
        patience_s: How long time stands after the last answer, at most [s] of wall time.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._idle: dict[str, tuple[State, float]] = {}

    def update(self, idle: Mapping[str, State]) -> None:
        """Take the groups that are reserved and do nothing, with their states; one that is new is awaited from now."""
        now, known = clock.monotonic(), self._idle
        self._idle = {
            group: known[group] if group in known and known[group][0] is state else (state, now)
            for group, state in idle.items()
        }

    @property
    def present(self) -> bool:
        """Whether somebody is awaited."""
        newest = max((since for _, since in self._idle.values()), default=-math.inf)
        return clock.monotonic() - newest < self._patience_s
