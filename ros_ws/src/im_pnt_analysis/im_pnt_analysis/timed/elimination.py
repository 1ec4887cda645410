"""Linear algebra of Markov chains.

Elimination without subtraction: Grassmann, Taksar, Heyman, "Regenerative Analysis and Steady State Distributions for
Markov Chains", Operations Research 33(5), 1985. It loses no digits.
"""

import heapq
from collections.abc import Collection, Sequence
from dataclasses import dataclass

Rows = Sequence[dict[int, float]]
"""For each state the rates to other states; the diagonal is left out."""


@dataclass(slots=True)
class Eliminated:
    """Chain without some of the states.

    Attributes:
        rows: For each state that is left the rates to others that are left.
        order: States removed, in order.
        inflow: For each removed state the rates into it when it was removed, divided by its whole rate.
    """

    rows: list[dict[int, float]]
    order: list[int]
    inflow: dict[int, list[tuple[int, float]]]

    def extend(self, measure: dict[int, float]) -> None:
        """Give the removed states the part of a stationary measure of the remaining ones."""
        for state in reversed(self.order):
            measure[state] = sum((measure[i] * share for i, share in self.inflow[state] if i in measure), start=0.0)


def eliminate(rows: Rows, remove: Collection[int]) -> Eliminated:
    """Remove states from a chain, beginning with the fewest neighbours.

    Args:
        rows: The chain; every removed state can be left for good.
        remove: States to remove.
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
        left.discard(state)
        row = work[state]
        whole = sum(row.values())  # not one minus the own rate: sums alone lose no digits
        shares = [(other, rate / whole) for other, rate in row.items()]
        result.order.append(state)
        inflow: list[tuple[int, float]] = []
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


def stationary(rows: Rows, states: Sequence[int]) -> dict[int, float]:
    """Compute a stationary measure of an irreducible chain: the part of each state, not normalised.

    Args:
        rows: Rates; what leads out of ``states`` is not there.
        states: The states of the chain.
    """
    measure = {states[0]: 1.0}
    eliminate(rows, states[1:]).extend(measure)
    return measure
