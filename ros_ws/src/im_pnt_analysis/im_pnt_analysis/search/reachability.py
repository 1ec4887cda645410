"""Exact search of the reachable markings, breadth first, so every counterexample is a shortest one."""

from collections.abc import Callable, Sequence

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled
from im_pnt_analysis.search.frontier import OverflowedError, expand
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.packing import TooManyTokensError
from im_pnt_analysis.search.state_space import CollisionError, StateSpace

_TESTS_AT_ONCE = 1 << 20


class Search:
    """Breadth-first search with interruption and continuation.

    Args:
        compiled: The net.
        initial: Tokens of each place in the first marking.
        bounds: For each place a proved bound on its tokens, None where there is none; they make markings smaller.
        kinds: For each transition bits (1, 2) to remember for the markings that enable it.
        progress: Told the number of markings now and then.

    Raises:
        TooManyTokensError: A place holds more than a word can count.

    Attributes:
        found: What it has found.
        expanded: Number of markings whose firings are known; the first ones of ``found``.
        stopped: Why the last :meth:`run` ended early, empty if every reachable marking is found.
    """

    def __init__(
        self,
        compiled: Compiled,
        initial: Sequence[int],
        bounds: Sequence[int | None] | None = None,
        kinds: Sequence[int] | None = None,
        progress: Callable[[int], None] = lambda count: None,
    ) -> None:
        self.found = StateSpace(compiled, initial, bounds or [None] * len(compiled.places))
        self.expanded = 0
        self.stopped = "not begun"
        self._kinds = kinds or [1] * len(compiled.transitions)
        self._progress = progress
        self._layer_end = 1
        self._widths = (0, 1)
        self._block = max(256, _TESTS_AT_ONCE // max(1, len(compiled.transitions)))

    @property
    def complete(self) -> bool:
        """Whether every reachable marking was found and expanded."""
        return not self.stopped

    @property
    def widening(self) -> bool:
        """Whether the last layer has more markings than the one before: most of the space is still to come."""
        return self._widths[1] > self._widths[0]

    def run(self, limits: SearchLimits, deadline: float) -> str:
        """Continue the search.

        Args:
            limits: Where to give up.
            deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s].

        Returns:
            Why it ended early; empty if every reachable marking is found.
        """
        found = self.found
        self.stopped = ""
        try:
            while self.expanded < found.count and not self.stopped:
                try:
                    end = min(self._layer_end, self.expanded + self._block)
                    expand(found, self.expanded, end, self._kinds)
                    self._advance(end)
                except OverflowedError as error:
                    found.widen(error.guards)
                except CollisionError:
                    found.rehash()
                self.stopped = self.stopped or self._limit(limits, deadline)
                self._progress(found.count)
        except TooManyTokensError as error:
            self.stopped = str(error)
        if self.expanded == found.count:
            self.stopped = ""
        return self.stopped

    def _limit(self, limits: SearchLimits, deadline: float) -> str:
        if self.found.count > limits.states:
            return f"more than {limits.states} markings"
        if self.found.memory > limits.memory:
            return f"{self.found.count} markings and no end: more memory than {limits.memory / 2**30:.3g} GiB"
        if thread_cpu() > deadline:
            return f"not finished in time, {self.found.count} markings"
        return ""

    def _advance(self, expanded: int) -> None:
        self.expanded = expanded
        if expanded == self._layer_end:
            self._widths = (self._widths[1], self.found.count - expanded)
            self._layer_end = self.found.count
