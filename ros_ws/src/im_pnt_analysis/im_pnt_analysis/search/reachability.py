"""Exact search of the reachable markings, breadth first, so every counterexample is a shortest one."""

from collections.abc import Callable, Sequence

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled
from im_pnt_analysis.search.frontier import NarrowFrontier, OverflowedError, expand_wide
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.packing import TooManyTokensError
from im_pnt_analysis.search.state_space import CollisionError, StateSpace

_TESTS_AT_ONCE = 1 << 18
_LAYER_US, _WORD_US = 150.0, 15.0
"""What a layer costs in arrays, and what each word of its markings adds [us]."""
_TEST_US = 0.004
"""What a transition and marking cost there in addition [us]."""
_MARKING_US = 8.0
"""What a marking costs by itself [us]."""
_WIDEST = 200
_MET_AT_ONCE = 500_000
_CLOCK_EVERY = 64


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
        transitions = max(1, len(compiled.transitions))
        gain = max(_TEST_US, _MARKING_US - _TEST_US * transitions)
        self._narrow = min(_WIDEST, 1 + int((_LAYER_US + _WORD_US * self.found.packing.words) / gain))
        self._block = max(256, _TESTS_AT_ONCE // transitions)

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
                    if found.count - self.expanded <= self._narrow:
                        self._go_narrow(limits, deadline)
                    else:
                        end = min(self._layer_end, self.expanded + self._block)
                        expand_wide(found, self.expanded, end, self._kinds)
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

    def _go_narrow(self, limits: SearchLimits, deadline: float) -> None:
        narrow = NarrowFrontier(self.found, self.expanded, self._kinds)
        begin, expanded, layer_end = self.expanded, self.expanded, self._layer_end
        try:
            while expanded < narrow.count:
                narrow.expand(expanded)
                expanded += 1
                if expanded == layer_end:
                    self._widths = (self._widths[1], narrow.count - expanded)
                    layer_end = narrow.count
                if narrow.count - expanded > 2 * self._narrow:
                    break
                if narrow.count > limits.states or expanded - begin > _MET_AT_ONCE:
                    break
                if expanded % _CLOCK_EVERY == 0 and thread_cpu() > deadline:
                    break
        finally:
            self.expanded, self._layer_end = expanded, layer_end
            narrow.flush()
