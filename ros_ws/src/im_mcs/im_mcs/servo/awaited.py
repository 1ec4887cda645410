"""Awaited owners: simulated time stands for others until the next request."""

import math
from collections.abc import Mapping, Set

from im_core import clock
from im_mcs.state import State


class AwaitedOwners:
    """Owners of idle groups, answered and still without a next request.

    What an owner does between two requests, such as planning a path, takes no simulated time at clock factor 0 while
    nobody else moves. Where another group moves it would take as much as the computer happens to simulate meanwhile:
    some seconds. So time stands for them too, but not for ever: an owner may not want anything more for a long while.

    Args:
        patience_s: How long time stands after the last answer, at most [s] of wall time.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._states: Mapping[str, State] = {}
        self._busy: Set[str] = set()
        self._idle: dict[str, State] = {}
        self._since: dict[str, float] = {}
        self._until = -math.inf

    def update(self, states: Mapping[str, State], busy: Set[str]) -> None:
        """Await the owners of idle groups; a group idle anew, or in another state, from now on.

        Args:
            states: States of the groups that are reserved; another object after every change.
            busy: Groups that do something.
        """
        if states is self._states and busy == self._busy:
            return
        self._states, self._busy = states, busy
        idle = {group: state for group, state in states.items() if group not in busy}
        now, known = clock.monotonic(), self._idle
        self._since = {group: self._since[group] if known.get(group) is state else now for group, state in idle.items()}
        self._idle = idle
        self._until = max(self._since.values(), default=-math.inf) + self._patience_s

    @property
    def present(self) -> bool:
        """Whether somebody is awaited."""
        return clock.monotonic() < self._until
