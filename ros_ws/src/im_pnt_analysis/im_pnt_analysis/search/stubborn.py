"""Search for a deadlock with only a stubborn set of the enabled transitions in each marking.

What is left out commutes with what is fired, so every dead marking is still found (Valmari, "Stubborn sets for reduced
state space generation", 1991; strong stubborn sets of place/transition nets). Inhibitor arcs count as dependence.
"""

from dataclasses import dataclass, replace
from heapq import heappop, heappush

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled
from im_pnt_analysis.structure.reduction import reduce_for_deadlock

_CHECK_EVERY = 256
_SEEDS = 8

Vector = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Deadlock:
    """Result of a search for a dead marking.

    Attributes:
        found: Whether there is one; None: the search ended early.
        sequence: Firing sequence that leads there, not always a shortest one.
        marking: Tokens of each place in it.
        states_searched: Number of markings seen.
        reason: Why the search ended early, empty if it did not.
    """

    found: bool | None
    sequence: tuple[str, ...] = ()
    marking: Vector = ()
    states_searched: int = 0
    reason: str = ""


def find_deadlock(
    compiled: Compiled, initial: Vector, deadline: float | None = None, max_states: int = 1_000_000
) -> Deadlock:
    """Search for a reachable marking without an enabled transition, in the reduced net.

    Args:
        compiled: The net.
        initial: Initial marking, tokens of each place.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; None: never.
        max_states: Number of markings at which to give up.
    """
    reduced = reduce_for_deadlock(compiled, initial, deadline)
    result = search(reduced.compiled, reduced.initial, deadline, max_states)
    if not result.found:
        return result
    sequence = reduced.expand(result.sequence)
    number = {name: index for index, name in enumerate(compiled.transitions)}
    marking = initial
    for name in sequence:
        marking = compiled.fire(marking, number[name])
    return replace(result, sequence=sequence, marking=marking)


def search(compiled: Compiled, initial: Vector, deadline: float | None = None, max_states: int = 1_000_000) -> Deadlock:
    """Search the net without reduction; markings with few enabled transitions first. The arguments are the same."""
    always = next((t for t, arcs in enumerate(compiled.inputs) if not arcs and not compiled.inhibitors[t]), None)
    if always is not None:  # always enabled: no marking is dead
        return Deadlock(False, states_searched=1)
    stubborn = StubbornSets(compiled)
    first = frozenset(stubborn.enabled(initial))
    parents: dict[Vector, tuple[Vector, int]] = {initial: (initial, -1)}
    queue = [(len(first), 0, initial, first)]
    steps = 0
    while queue:
        _, _, marking, enabled = heappop(queue)
        if not enabled:
            return Deadlock(True, _sequence(compiled, parents, marking), marking, len(parents))
        for transition in stubborn.choose(marking, enabled):
            after = compiled.fire(marking, transition)
            if after not in parents:
                parents[after] = (marking, transition)
                following = stubborn.enabled_after(after, transition, enabled)
                heappush(queue, (len(following), len(parents), after, following))
        steps += 1
        if steps % _CHECK_EVERY == 1 and deadline is not None and thread_cpu() > deadline:
            return Deadlock(None, states_searched=len(parents), reason=f"the time is up after {len(parents)} markings")
        if len(parents) > max_states:
            return Deadlock(None, states_searched=len(parents), reason=f"more than {max_states} markings")
    return Deadlock(False, states_searched=len(parents))


def _sequence(compiled: Compiled, parents: dict[Vector, tuple[Vector, int]], marking: Vector) -> tuple[str, ...]:
    names: list[str] = []
    while (step := parents[marking])[1] >= 0:
        marking = step[0]
        names.append(compiled.transitions[step[1]])
    return tuple(reversed(names))


class StubbornSets:
    """Strong stubborn sets of a net."""

    def __init__(self, compiled: Compiled) -> None:
        self._compiled = compiled
        self._all = range(len(compiled.transitions))
        change = [dict(pairs) for pairs in compiled.change]
        raising: list[list[int]] = [[] for _ in compiled.places]
        lowering: list[list[int]] = [[] for _ in compiled.places]
        for transition, delta_of in enumerate(change):
            for place, delta in delta_of.items():
                (raising if delta > 0 else lowering)[place].append(transition)
        self._raising = [tuple(row) for row in raising]
        self._lowering = [tuple(row) for row in lowering]
        self._dependent = [self._dependence(transition, change) for transition in self._all]
        self._touched = [
            tuple({other for place in delta_of for row in self._tests(place) for other, _ in row})
            for delta_of in change
        ]

    def _tests(self, place: int) -> tuple[tuple[tuple[int, int], ...], ...]:
        return self._compiled.consumers[place], self._compiled.inhibited[place]

    def _dependence(self, transition: int, change: list[dict[int, int]]) -> tuple[int, ...]:
        """Return the transitions in mutual disabling with an enabled one."""
        compiled = self._compiled
        others: set[int] = set()
        for place, _ in compiled.inputs[transition]:
            others.update(self._lowering[place])
            if change[transition].get(place, 0) < 0:
                others.update(consumer for consumer, _ in compiled.consumers[place])
        for place, _ in compiled.inhibitors[transition]:
            others.update(self._raising[place])
        for place, delta in change[transition].items():
            if delta > 0:
                others.update(inhibited for inhibited, _ in compiled.inhibited[place])
        return tuple(others - {transition})

    def enabled(self, marking: Vector) -> list[int]:
        """Return the enabled transitions of a marking."""
        enabled = self._compiled.enabled
        return [transition for transition in self._all if enabled(marking, transition)]

    def enabled_after(self, marking: Vector, transition: int, before: frozenset[int]) -> frozenset[int]:
        """Return the enabled transitions of the marking after a firing.

        Args:
            marking: Tokens of each place after the firing.
            transition: The transition that has fired.
            before: The transitions that were enabled before.
        """
        touched = self._touched[transition]
        enabled = self._compiled.enabled
        return before.difference(touched).union([other for other in touched if enabled(marking, other)])

    def choose(self, marking: Vector, enabled: frozenset[int]) -> list[int]:
        """Return the enabled transitions of a small stubborn set, in the order of the net.

        Args:
            marking: Tokens of each place.
            enabled: The transitions that are enabled there, at least one.
        """
        best = sorted(enabled)
        for seed in best[:: max(1, len(best) // _SEEDS)]:
            chosen = self._closure(marking, seed, enabled, len(best))
            if chosen is not None:
                best = sorted(chosen)
                if len(best) == 1:
                    break
        return best

    def _closure(self, marking: Vector, seed: int, enabled: frozenset[int], limit: int) -> list[int] | None:
        """Return the enabled transitions of the stubborn set around a seed; None: not fewer than the limit."""
        closed = {seed}
        stack = [seed]
        chosen: list[int] = []
        while stack:
            transition = stack.pop()
            if transition in enabled:
                chosen.append(transition)
                if len(chosen) >= limit:
                    return None
                needed = self._dependent[transition]
            else:
                needed = self._enablers(marking, transition, closed)
            for other in needed:
                if other not in closed:
                    closed.add(other)
                    stack.append(other)
        return chosen

    def _enablers(self, marking: Vector, transition: int, closed: set[int]) -> tuple[int, ...]:
        """Return transitions necessary to enable a disabled one, by the arc with the fewest such transitions."""
        compiled = self._compiled
        best: tuple[int, ...] | None = None
        fewest = len(self._all) + 1
        for arcs, enablers, lacking in (
            (compiled.inputs[transition], self._raising, True),
            (compiled.inhibitors[transition], self._lowering, False),
        ):
            for place, weight in arcs:
                if (marking[place] < weight) is lacking:
                    new = sum([other not in closed for other in enablers[place]])
                    if new < fewest:
                        best, fewest = enablers[place], new
        assert best is not None
        return best
