"""Linear algebra of Markov chains, in fractions for exact answers, in floats for fast ones.

Elimination without subtraction: Grassmann, Taksar, Heyman, "Regenerative Analysis and Steady State Distributions for
Markov Chains", Operations Research 33(5), 1985. In floats it loses no digits, in fractions it is exact.
"""

import heapq
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Generic, TypeVar

from im_core.clock import thread_cpu

N = TypeVar("N", Fraction, float)
Rows = Sequence[dict[int, N]]
"""For each state the rates to other states; the diagonal is left out."""


class TookTooLongError(Exception):
    """Error: an elimination has passed the deadline; another method may be faster."""


def fraction(value: float) -> Fraction:
    """Return the simplest fraction of a float: 1/3 and not 6004799503160661/2**54."""
    simple = Fraction(value).limit_denominator(1_000_000)
    return simple if float(simple) == value else Fraction(repr(value))


@dataclass(slots=True)
class Eliminated(Generic[N]):
    """Chain without some of the states.

    Attributes:
        rows: For each state that is left the rates to others that are left.
        order: States removed, in order.
        inflow: For each removed state the rates into it when it was removed, divided by its whole rate.
    """

    rows: list[dict[int, N]]
    order: list[int]
    inflow: dict[int, list[tuple[int, N]]]

    def extend(self, measure: dict[int, N]) -> None:
        """Give the removed states the part of a stationary measure of the remaining ones."""
        zero = next(iter(measure.values())) * 0
        for state in reversed(self.order):
            measure[state] = sum((measure[i] * share for i, share in self.inflow[state] if i in measure), start=zero)


def eliminate(rows: Rows[N], remove: Collection[int], deadline: float | None = None) -> Eliminated[N]:
    """Remove states from a chain, beginning with the fewest neighbours.

    Args:
        rows: The chain; every removed state can be left for good.
        remove: States to remove.
        deadline: When to give up, in :func:`im_core.clock.thread_cpu` [s]; None: never.

    Raises:
        TookTooLongError: The deadline has passed.
    """
    work = [dict(row) for row in rows]
    into: list[set[int]] = [set() for _ in rows]
    for state, row in enumerate(work):
        for other in row:
            into[other].add(state)
    result = Eliminated(work, [], {})
    left = set(remove)
    heap = [(len(into[state]) * len(work[state]), state) for state in left]
    heapq.heapify(heap)
    while heap:
        cost, state = heapq.heappop(heap)
        if state not in left:
            continue
        now = len(into[state]) * len(work[state])
        if now > cost:  # neighbours were added since: back into the heap with the present cost
            heapq.heappush(heap, (now, state))
            continue
        if deadline is not None and thread_cpu() > deadline:
            raise TookTooLongError
        left.discard(state)
        row = work[state]
        whole = sum(row.values())  # not one minus the own rate: sums alone lose no digits
        shares = [(other, rate / whole) for other, rate in row.items()]
        result.order.append(state)
        inflow: list[tuple[int, N]] = []
        for source in into[state]:
            rates = work[source]
            rate = rates.pop(state)
            inflow.append((source, rate / whole))
            for other, share in shares:
                if other != source:  # a way back to its source changes nothing there
                    known = rates.get(other)
                    if known is None:
                        rates[other] = rate * share
                        into[other].add(source)
                    else:
                        rates[other] = known + rate * share
        for other in row:
            into[other].discard(state)
        result.inflow[state] = inflow
        work[state] = {}
        into[state] = set()
    return result


def stationary(rows: Rows[N], states: Sequence[int], one: N, deadline: float | None = None) -> dict[int, N]:
    """Compute a stationary measure of an irreducible chain: the part of each state, not normalised.

    Args:
        rows: Rates; what leads out of ``states`` is not there.
        states: The states of the chain.
        one: The number 1 in the arithmetic wanted.
        deadline: When to give up, in :func:`im_core.clock.thread_cpu` [s]; None: never.

    Raises:
        TookTooLongError: The deadline has passed.
    """
    measure = {states[0]: one}
    eliminate(rows, states[1:], deadline).extend(measure)
    return measure
