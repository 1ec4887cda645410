"""Transitions without action that take their time (GSPN): race, enabling memory, one server."""

from collections.abc import Callable, Sequence

from im_pnt.choosing import Chooser
from im_pnt.enabling import Enabling
from im_pnt.net import Transition
from im_pnt.timers import Timer, Timers


class Delays:
    """The clocks of the enabled transitions that have a delay.

    Args:
        transitions: The transitions of the expanded net.
        enabling: The marking, and what it enables.
        chooser: Is told which have waited long enough; has the dice.
        timers: Strike.
        clock: Present time [s].
    """

    def __init__(
        self,
        transitions: Sequence[Transition],
        enabling: Enabling,
        chooser: Chooser,
        timers: Timers,
        clock: Callable[[], float],
    ) -> None:
        self._transitions, self._enabling, self._chooser = transitions, enabling, chooser
        self._timers, self._clock = timers, clock
        self._running: dict[int, Timer] = {}

    def waits(self, index: int) -> bool:
        """Whether a transition that is enabled has still to wait; starts its clock where its guard lets it."""
        if index not in self._chooser.delayed or index in self._chooser.ripe:
            return False
        delay = self._transitions[index].delay
        if delay is not None and index not in self._running and self._chooser.holds(index):
            self._enabling.clocks.add(index)
            time = self._clock() + delay.sample(self._chooser.dice)
            self._running[index] = self._timers.at(time, lambda: self._ripen(index))
        return True

    def settle(self, fired: int | None = None) -> None:
        """Stops the clocks of what a firing has disabled, and of the transition that has fired."""
        crossed, unmet = self._enabling.crossed, self._enabling.unmet
        for index in crossed:
            if unmet[index]:
                self._stop(index)
        crossed.clear()
        if fired in self._enabling.clocks:
            self._stop(fired)

    def give_up(self, index: int) -> None:
        """Has a transition wait anew that its guard or symbol does not let fire any more."""
        if index in self._chooser.ripe:
            self._stop(index)

    def _stop(self, index: int) -> None:
        self._timers.cancel(self._running.pop(index, None))
        self._enabling.clocks.discard(index)
        self._chooser.ripe.discard(index)

    def _ripen(self, index: int) -> None:
        del self._running[index]
        self._chooser.ripe.add(index)
        self._enabling.consider(index)
