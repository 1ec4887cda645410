"""Loop of rate groups: with deadlines, or as fast as it can."""

from collections.abc import Callable

from im_core import clock
from im_core.rate_groups.groups import RateGroups
from im_core.rate_groups.pacer import Pacer


class RateLoop:
    """Runner of rate groups, one base period after the other.

    A base period begins at its deadline. Where the loop comes more than a period late, base periods are missed, and
    the policies of the functions decide.

    Args:
        groups: The functions.
        wall_period_s: Wall time of a base period [s]; 0: no deadlines, as fast as the functions return.
    """

    def __init__(self, groups: RateGroups, wall_period_s: float) -> None:
        self.groups, self.pacer = groups, Pacer(wall_period_s)
        self._tick = -1

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Run base period after base period while a function says so."""
        while goes_on():
            self.pacer.wait()
            self.turn()

    def turn(self) -> None:
        """Call the functions due in the present base period: after :meth:`Pacer.wait`, and what else is to come first.

        Functions with several calls in a base period get the later ones at their times.
        """
        pacer, groups = self.pacer, self.groups
        self._tick += 1 + pacer.skipped
        paced = pacer.period_s > 0.0
        for part in range(groups.parts):
            due_s = pacer.due_s + part * pacer.period_s / groups.parts if paced else None
            if part and due_s is not None:
                clock.sleep_until(due_s)
            groups.run(self._tick, part, due_s)
