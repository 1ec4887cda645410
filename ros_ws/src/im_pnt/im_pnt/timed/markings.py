"""The reachable markings of a timed net: tangible ones, where time passes, and vanishing ones, left at once."""

from dataclasses import dataclass, field

from im_core.clock import monotonic
from im_pnt.errors import NetError
from im_pnt.timed.model import TimedNet

Vector = tuple[int, ...]

RENEWAL = -1
"""Stands for the transition that leads from the answer of a command to its beginning."""


class TooManyMarkingsError(NetError):
    """There are more markings than can be looked at."""


@dataclass(slots=True)
class Markings:
    """Reachable markings, numbered in the order they were found; the first is the initial one.

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
        """Returns a shortest firing sequence that leads to a marking, in the composition's names."""
        names: list[str] = []
        while state > 0:
            state, transition = self.parents[state]
            names.append(self.net.shown[transition])
        return names[::-1]


def reach(net: TimedNet, *, states: int = 1_000_000, seconds: float = 60.0) -> Markings:
    """Finds the markings that a timed net can reach; the answer of a command leads back to its beginning.

    Args:
        net: The timed net.
        states: Markings at most.
        seconds: Time for it [s].

    Raises:
        TooManyMarkingsError: More markings than that, or more time.
    """
    deadline = monotonic() + seconds
    compiled = net.compiled
    found = Markings(net, [net.initial], [(-1, -1)])
    number = {net.initial: 0}
    step = _Step(net)
    ends = net.ends or ()
    fire = compiled.fire
    current = 0
    while current < len(found.vectors):
        if current % 256 == 0 and monotonic() > deadline:
            raise _too_many(found, f"the markings were not all found in {seconds:g} s, {len(found.vectors)} so far")
        vector = found.vectors[current]
        if any(vector[place] for place in ends):
            found.tangible.append(False)
            found.arcs.append(((RENEWAL, 0, 1),))
            current += 1
            continue
        timed, firings = step.firings(vector, found.rivals)
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
        f"{what}; place {name} has come to {last[place]} tokens. 'pnt simulate --summary' estimates by simulation "
        "what cannot be computed",
        place=name,
    )


class _Step:
    """What can happen in a marking."""

    def __init__(self, net: TimedNet) -> None:
        self.net = net
        self._ready = net.compiled.enabled
        self._exponential = [timer.delay.kind == "exponential" for timer in net.timers]
        self._plain = [(i, timer.outcomes[0][0]) for i, timer in enumerate(net.timers) if timer.active is None]
        self._actions = [(i, timer.active) for i, timer in enumerate(net.timers) if timer.active is not None]

    def firings(self, vector: Vector, rivals: set[int]) -> tuple[bool, list[tuple[int, int]]]:
        """Returns whether time passes first, and the possible firings with their number of servers."""
        ready = self._ready
        for level in self.net.levels:
            if firings := [(transition, 1) for transition in level if ready(vector, transition)]:
                return False, firings
        running = [(timer, 1) for timer, transition in self._plain if ready(vector, transition)]
        running += [(timer, vector[active]) for timer, active in self._actions if vector[active]]
        if running:
            if len(running) > 1 or running[0][1] > 1:
                rivals.update(timer for timer, _ in running if not self._exponential[timer])
            timers = self.net.timers
            return True, [(outcome, servers) for timer, servers in running for outcome, _ in timers[timer].outcomes]
        for level in self.net.waiting:
            if firings := [(transition, 1) for transition in level if ready(vector, transition)]:
                return False, firings
        return True, []
