"""The Markov chain of a timed net: the markings, the rates and weights, the recurrent classes.

Time passes in tangible markings; vanishing ones are left at once, by weights instead of rates.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from im_core.clock import thread_cpu
from im_pnt.errors import NetError
from im_pnt_analysis.timed.elimination import Eliminated, eliminate, stationary
from im_pnt_analysis.timed.model import TimedNet

Vector = tuple[int, ...]

RENEWAL = -1
"""Stands for the transition that leads from the answer of a command to its beginning."""


class TooManyMarkingsError(NetError):
    """There are more markings than can be looked at."""


@dataclass(slots=True)
class Markings:
    """Reachable markings, numbered in the order of the discovery; the first is the initial one.

    Attributes:
        net: The timed net.
        vectors: Tokens of each place.
        parents: For each marking the marking and the transition that found it; (-1, -1) for the first.
        tangible: For each marking whether time passes in it; a marking that cannot be left is tangible.
        arcs: For each marking its firings: transition, marking reached, and how many servers work on it (tangible).
        rivals: Timers of no exponential delay that somewhere run beside another one; their means are not enough.
    """

    net: TimedNet
    vectors: list[Vector] = field(default_factory=list)
    parents: list[tuple[int, int]] = field(default_factory=list)
    tangible: list[bool] = field(default_factory=list)
    arcs: list[tuple[tuple[int, int, int], ...]] = field(default_factory=list)
    rivals: set[int] = field(default_factory=set)

    def sequence(self, state: int) -> list[str]:
        """Return a shortest firing sequence to a marking, in the composition's names."""
        names: list[str] = []
        while state > 0:
            state, transition = self.parents[state]
            names.append(self.net.shown[transition])
        return names[::-1]


def reach(net: TimedNet, *, states: int = 1_000_000, seconds: float = 60.0, stop_at_rivals: bool = False) -> Markings:
    """Find the reachable markings of a timed net; the answer of a command leads back to the beginning.

    Args:
        net: The timed net.
        states: Markings at most.
        seconds: CPU time for it [s].
        stop_at_rivals: End at the first timer that belongs into ``rivals``.

    Raises:
        TooManyMarkingsError: More markings than that, or more time.
    """
    deadline = thread_cpu() + seconds
    compiled = net.compiled
    found = Markings(net, [net.initial], [(-1, -1)])
    number = {net.initial: 0}
    step = _Step(net)
    ends = net.ends or ()
    fire = compiled.fire
    current = 0
    while current < len(found.vectors):
        if current % 256 == 0 and thread_cpu() > deadline:
            raise _too_many(found, f"the markings were not all found in {seconds:g} s, {len(found.vectors)} so far")
        vector = found.vectors[current]
        if any(vector[place] for place in ends):
            found.tangible.append(False)
            found.arcs.append(((RENEWAL, 0, 1),))  # the next command begins: the chain is recurrent
            current += 1
            continue
        timed, firings = step.firings(vector, found.rivals)
        if stop_at_rivals and found.rivals:
            break
        arcs: list[tuple[int, int, int]] = []
        for transition, servers in firings:
            after = fire(vector, transition)
            target = number.get(after)
            if target is None:
                target = len(found.vectors)
                if target >= states:
                    raise _too_many(found, f"there are more than {states} markings")
                number[after] = target
                found.vectors.append(after)
                found.parents.append((current, transition))
            arcs.append((transition, target, servers))
        found.tangible.append(timed)
        found.arcs.append(tuple(arcs))
        current += 1
    return found


def _too_many(found: Markings, what: str) -> TooManyMarkingsError:
    last = found.vectors[-1]
    place = max(range(len(last)), key=last.__getitem__)
    name = found.net.shown_places[place]
    return TooManyMarkingsError(
        f"{what}; place {name} has come to {last[place]} tokens. 'scripts/im pnt simulate --summary' estimates by "
        "simulation what cannot be computed",
        place=name,
    )


class _Step:
    """Possible firings of a marking."""

    def __init__(self, net: TimedNet) -> None:
        self.net = net
        self._ready = net.compiled.enabled
        self._exponential = [timer.delay.kind == "exponential" for timer in net.timers]
        self._plain = [
            (i, timer.outcomes[0][0][0], timer.servers) for i, timer in enumerate(net.timers) if timer.active is None
        ]
        self._actions = [(i, timer.active) for i, timer in enumerate(net.timers) if timer.active is not None]

    def firings(self, vector: Vector, rivals: set[int]) -> tuple[bool, list[tuple[int, int]]]:
        """Return whether time passes first, and the possible firings with the number of servers."""
        ready = self._ready
        for level in self.net.levels:
            if firings := [(transition, 1) for transition in level if ready(vector, transition)]:
                return False, firings
        degree = self.net.compiled.degree
        running = [
            (timer, 1 if servers == 1 else min(servers, degree(vector, transition)))
            for timer, transition, servers in self._plain
            if ready(vector, transition)
        ]
        running += [(timer, vector[active]) for timer, active in self._actions if vector[active]]
        if running:
            if len(running) > 1 or running[0][1] > 1:
                rivals.update(timer for timer, _ in running if not self._exponential[timer])
            timers = self.net.timers
            return True, [
                (way, servers)
                for timer, servers in running
                for ways, _ in timers[timer].outcomes
                if (way := next((way for way in ways if ready(vector, way)), None)) is not None
            ]
        for level in self.net.waiting:
            if firings := [(transition, 1) for transition in level if ready(vector, transition)]:
                return False, firings
        return True, []


_SMALL = 2000
"""States up to which elimination is preferred to sparse factorisation: it loses no digits."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Chain with a state for every marking.

    Attributes:
        found: The markings.
        firings: For each marking its firings: transition, marking reached, rate [1/s] or weight.
        rows: For each marking the rates or weights to other markings.
    """

    found: Markings
    firings: list[list[tuple[int, int, float]]]
    rows: list[dict[int, float]]


def chain(found: Markings) -> Chain:
    """Give the firings the rates and weights."""
    net = found.net
    speed: dict[int, float] = {}
    for timer in net.timers:
        delay = timer.delay
        rate = delay.values[0] if delay.kind == "exponential" else 1.0 / delay.mean
        speed.update((way, rate * probability) for ways, probability in timer.outcomes for way in ways)
    firings: list[list[tuple[int, int, float]]] = []
    rows: list[dict[int, float]] = []
    for state, arcs in enumerate(found.arcs):
        if found.tangible[state]:
            rated = [(transition, target, speed[transition] * servers) for transition, target, servers in arcs]
        else:
            rated = [(t, target, 1.0 if t == RENEWAL else net.weight[t] or 1.0) for t, target, _ in arcs]
        row: dict[int, float] = {}
        for _, target, rate in rated:
            if target != state:
                row[target] = row[target] + rate if target in row else rate
        firings.append(rated)
        rows.append(row)
    return Chain(found, firings, rows)


def recurrent_classes(found: Markings) -> list[list[int]]:
    """Find the sets of markings with an endless return; the first of each is tangible.

    Raises:
        NetError: One of them has no tangible marking: immediate transitions go round without time passing.
    """
    from im_pnt_analysis.timed.sparse import bottom_classes

    classes = bottom_classes(found.arcs)
    for members in classes:
        first = next((state for state in members if found.tangible[state]), None)
        if first is None:
            way, loop = found.sequence(members[0]), _loop(found, members)
            raise NetError(
                "immediate transitions go round for ever without time passing: after "
                f"{' -> '.join(way) or '(nothing)'}, {' -> '.join(loop)} repeats and nothing else can happen",
                sequence=way,
                repeat=loop,
            )
        members.remove(first)
        members.insert(0, first)
    return classes


def _loop(found: Markings, members: Sequence[int]) -> list[str]:
    """Return firings from the first marking of a class back to the same marking."""
    start = members[0]
    parents: dict[int, tuple[int, int]] = {}
    queue = deque([start])
    while start not in parents:
        state = queue.popleft()
        for transition, target, _ in found.arcs[state]:
            if target not in parents:
                parents[target] = (state, transition)
                queue.append(target)
    names: list[str] = []
    state = start
    while not names or state != start:
        state, transition = parents[state]
        names.append(found.net.shown[transition])
    return names[::-1]


def class_probabilities(links: Chain, classes: Sequence[Sequence[int]]) -> list[float]:
    """Compute the probability of each recurrent class of the chain.

    Args:
        links: The chain; it begins in its first marking.
        classes: All its recurrent classes.
    """
    home = {state: members[0] for members in classes for state in members}
    if len(classes) == 1 or 0 in home:
        return [float(len(classes) == 1 or home[0] == members[0]) for members in classes]
    rows: list[dict[int, float]] = []
    for state, row in enumerate(links.rows):
        merged: dict[int, float] = {}
        if state not in home:
            for target, rate in row.items():
                target = home.get(target, target)
                merged[target] = merged[target] + rate if target in merged else rate
        rows.append(merged)
    passing = [state for state in range(1, len(rows)) if state not in home]
    last = eliminate(rows, passing).rows[0]
    whole = sum(last.values())
    return [last.get(members[0], 0.0) / whole for members in classes]


def class_measure(links: Chain, members: Sequence[int]) -> tuple[dict[int, float], str]:
    """Compute the stationary measure of a recurrent class, and name the method.

    Time shares of tangible markings add up to 1; of a vanishing marking the measure times a weight is a rate of firing.

    Args:
        links: The chain.
        members: States of the class, a tangible one first.

    Raises:
        NetError: The equations of a large class could not be solved well enough.
    """
    tangible = [state for state in members if links.found.tangible[state]]
    if len(tangible) <= _SMALL:
        measure = stationary(links.rows, members)
        method = "elimination without subtraction"
    else:
        from im_pnt_analysis.timed.sparse import stationary_sparse

        vanishing = [state for state in members if not links.found.tangible[state]]
        without = eliminate(links.rows, vanishing) if vanishing else Eliminated(links.rows, [], {})
        measure, method = stationary_sparse(without.rows, tangible)
        without.extend(measure)
    whole = sum(measure[state] for state in tangible)
    return {state: value / whole for state, value in measure.items()}, method
