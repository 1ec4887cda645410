"""Short ways between poses: the order of the visits, and of a redundant arm the configuration for each pose."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from im_cell.visit_order import BLOCKED_S, visit_order

Array = NDArray[np.float64]

#: Most rounds of drawn configurations, the share of the spread that the next round keeps, the share of the time that a
#: round must save for another one, and a saving that is rounding [s].
ROUNDS = 6
_NARROWER, _SAVED, _ROUNDING_S = 0.7, 5e-3, 1e-6


class ShortWays:
    """Order of poses and configurations for them, by the time of all motions.

    For an order the best of all configurations are found by dynamic programming, and for configurations the best order
    by exchange (:func:`visit_order`), in turns. Each round draws new configurations about the best ones, nearer to them
    than the round before.

    Args:
        times: Of the motions between configurations of shapes (m, n) and (k, n), as rows of both: shape (m, k) [s].
        others: Draws configurations of pose ``rank`` about one, shape (m, n), at a spread of 0 to 1.
        free: Whether the straight way between two configurations is free.
    """

    def __init__(
        self,
        times: Callable[[Array, Array], Array],
        others: Callable[[int, Array, float], Array],
        free: Callable[[Array, Array], bool],
    ) -> None:
        self._times, self._others, self._free = times, others, free

    def shorten(self, start: Array, first: Sequence[Array], told: Callable[[str], None]) -> list[tuple[int, Array]]:
        """Return ranks of poses in the order of their visits, each with its configuration.

        Args:
            start: Where the arm begins, shape (n,) [rad or m].
            first: A configuration for each pose.
            told: Takes a sentence of progress.
        """
        best, spread, before = [start, *first], 1.0, np.inf
        order = list(range(len(best)))
        for number in range(1, ROUNDS + 1):
            drawn = [self._others(rank, q, spread) for rank, q in enumerate(best[1:])]
            choices = [start[None], *(np.vstack([q, more]) for q, more in zip(best[1:], drawn, strict=True))]
            order, best, seconds = self._round(order, choices)
            told(f"round {number} of {ROUNDS}: {seconds:.1f} s of motion")
            if seconds > (1.0 - _SAVED) * before:
                break
            spread, before = spread * _NARROWER, seconds
        return [(rank - 1, best[rank]) for rank in order[1:]]

    def _round(self, order: list[int], choices: list[Array]) -> tuple[list[int], list[Array], float]:
        """Return the best order and configurations among choices, and the time of the motions [s]."""
        blocked = dict[tuple[int, int], Array]()  # seconds more of each way between the choices of two poses
        while True:
            chosen, seconds = self._chosen(order, choices, blocked)
            best = [choices[rank][chosen[rank]] for rank in range(len(order))]
            times = self._times(np.array(best), np.array(best))
            for (a, b), more in blocked.items():
                times[a, b] += more[chosen[a], chosen[b]]
            shorter = visit_order(times)
            if sum(times[a, b] for a, b in pairwise(shorter)) < seconds - _ROUNDING_S:
                order = shorter
                continue
            news = [(a, b) for a, b in pairwise(order) if times[a, b] < BLOCKED_S and not self._free(best[a], best[b])]
            if not news:
                return order, best, seconds
            for a, b in news:
                for one, other in ((a, b), (b, a)):
                    more = blocked.setdefault((one, other), np.zeros((len(choices[one]), len(choices[other]))))
                    more[chosen[one], chosen[other]] = BLOCKED_S

    def _chosen(
        self, order: Sequence[int], choices: Sequence[Array], blocked: dict[tuple[int, int], Array]
    ) -> tuple[list[int], float]:
        """Return the number of the best choice for each pose in an order, and the time of the motions [s]."""
        cost, before = np.zeros(1), list[NDArray[np.intp]]()
        for a, b in pairwise(order):
            ways = cost[:, None] + self._times(choices[a], choices[b]) + blocked.get((a, b), 0.0)
            before.append(ways.argmin(axis=0))
            cost = ways.min(axis=0)
        chosen, last = [0] * len(order), int(cost.argmin())
        for rank, back in zip(order[:0:-1], before[::-1], strict=True):
            chosen[rank], last = last, int(back[last])
        return chosen, float(cost.min())
