"""Siphons and traps, and the statements on deadlocks.

A siphon, once empty, stays empty; a trap, once marked, stays marked (Murata, 1989, section VI). The places that are
empty in a dead marking of an ordinary net are a siphon. Inhibitor arcs are left out: what holds of the sets holds with
them too.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, IndexedArcs

_LEAST_MS = 20
_INTERRUPTED = ("timeout", "canceled")  # what z3 says when its time is over


class ClosedSets:
    """Sets of places closed under transitions: every giver to the set also takes from the set.

    Attributes:
        pairs: For each transition the places it takes from and those it gives to.

    Args:
        takes: For each transition the arcs by which it takes.
        gives: For each transition the arcs by which it gives.
    """

    def __init__(self, takes: Sequence[IndexedArcs], gives: Sequence[IndexedArcs]) -> None:
        self.pairs = [
            (frozenset(place for place, _ in needed), frozenset(place for place, _ in given))
            for needed, given in zip(takes, gives, strict=True)
        ]
        self._taking: dict[int, list[int]] = {}
        for transition, (needed, _) in enumerate(self.pairs):
            for place in needed:
                self._taking.setdefault(place, []).append(transition)

    def largest(self, places: Iterable[int]) -> frozenset[int]:
        """Return the largest closed set within some places; possibly empty."""
        left = set(places)
        self._drop(left, [given for needed, given in self.pairs if left.isdisjoint(needed)])
        return frozenset(left)

    def minimal(self, places: frozenset[int], keep: Callable[[frozenset[int]], bool] = bool) -> frozenset[int]:
        """Shrink a closed set to a minimal one.

        Args:
            places: The closed set.
            keep: Property that it has and must not lose; by default that it is not empty.
        """
        for place in sorted(places):
            if place in places:
                left = set(places)
                self._drop(left, [frozenset((place,))])
                if keep(smaller := frozenset(left)):
                    places = smaller
        return places

    def _drop(self, left: set[int], groups: list[frozenset[int]]) -> None:
        """Remove places from a set, and all others unable to stay without the removed ones."""
        while groups:
            for place in groups.pop() & left:
                left.discard(place)
                for transition in self._taking.get(place, ()):
                    needed, given = self.pairs[transition]
                    if left.isdisjoint(needed):
                        groups.append(given)


def siphon_sets(compiled: Compiled) -> ClosedSets:
    """Return the siphons of a net: every giver to one of the places takes from one."""
    return ClosedSets(compiled.inputs, compiled.outputs)


def trap_sets(compiled: Compiled) -> ClosedSets:
    """Return the traps of a net: every taker from one of the places gives to one."""
    return ClosedSets(compiled.outputs, compiled.inputs)


def names(compiled: Compiled, places: Iterable[int]) -> tuple[str, ...]:
    """Return the names of some places, in the order of the net."""
    return tuple(compiled.places[place] for place in sorted(places))


def emptied_siphon(compiled: Compiled, initial: tuple[int, ...], marking: tuple[int, ...]) -> tuple[str, ...]:
    """Return a smallest possible siphon, marked at first and empty now; empty: there is none.

    Args:
        compiled: The net.
        initial: Initial marking, tokens of each place.
        marking: Tokens of each place now.
    """
    sets = siphon_sets(compiled)
    empty = sets.largest(_unmarked(marking))
    if not any(initial[place] for place in empty):
        return ()
    return names(compiled, sets.minimal(empty, keep=lambda part: any(initial[place] for place in part)))


def _unmarked(marking: tuple[int, ...]) -> list[int]:
    return [place for place, tokens in enumerate(marking) if not tokens]


@dataclass(frozen=True, slots=True)
class Families:
    """Minimal sets of places.

    Attributes:
        sets: The sets by name of place.
        complete: Whether these are all.
        reason: Why not, empty if they are.
    """

    sets: tuple[tuple[str, ...], ...]
    complete: bool
    reason: str = ""


def siphons(compiled: Compiled, limit: int = 200, deadline: float | None = None) -> Families:
    """Find minimal siphons: sets of places where every giver to the set also takes from the set.

    Args:
        compiled: The net.
        limit: Number at which to stop.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; None: never.
    """
    return _minimal_sets(compiled, siphon_sets(compiled), limit, deadline)


def traps(compiled: Compiled, limit: int = 200, deadline: float | None = None) -> Families:
    """Find minimal traps: sets of places where every taker from the set also gives to the set.

    Args:
        compiled: The net.
        limit: Number at which to stop.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s]; None: never.
    """
    return _minimal_sets(compiled, trap_sets(compiled), limit, deadline)


def _minimal_sets(compiled: Compiled, sets: ClosedSets, limit: int, deadline: float | None) -> Families:
    search = _ClosedSetSearch(sets, len(compiled.places), deadline)
    found: list[tuple[str, ...]] = []
    while (places := search.next()) is not None:
        if len(found) == limit:
            return Families(tuple(found), complete=False, reason=f"more than {limit}")
        places = sets.minimal(places)
        found.append(names(compiled, places))
        search.exclude(places)
    return Families(tuple(found), not search.reason, search.reason)


class _ClosedSetSearch:
    """Closed sets one after another, by satisfiability."""

    def __init__(self, sets: ClosedSets, n_places: int, deadline: float | None) -> None:
        import z3  # takes longer than most nets do, and only this class needs it

        self.reason = ""
        self._deadline = deadline
        self._z3 = z3
        context = z3.Context()
        self._member = [z3.Bool(f"p{place}", context) for place in range(n_places)]
        self._solver = z3.SolverFor("QF_FD", ctx=context)
        self._solver.set("ctrl_c", False)  # Ctrl-C is for whoever called, not an answer of the solver
        if n_places:
            self._solver.add(z3.Or(self._member))
        for needed, given in dict.fromkeys(sets.pairs):
            for place in given - needed:
                self._solver.add(z3.Or([z3.Not(self._member[place]), *(self._member[other] for other in needed)]))

    def exclude(self, places: Iterable[int]) -> None:
        """Exclude all sets with all the given places."""
        self._solver.add(self._z3.Or([self._z3.Not(self._member[place]) for place in places]))

    def next(self) -> frozenset[int] | None:
        """Return a set not excluded yet; None: there is none, or ``reason`` names a met limit."""
        if not self._member:
            return None
        answer = self._z3.unknown
        while answer == self._z3.unknown:
            if self._deadline is not None:
                left = self._deadline - thread_cpu()
                if left <= 0.0:
                    self.reason = "the time is up"
                    return None
                # the solver counts wall time: on a busy computer it is asked again for the CPU time that is left
                self._solver.set("timeout", int(max(_LEAST_MS, min(2**31, 1000 * left))))
            answer = self._solver.check()
            if answer == self._z3.unknown and self._solver.reason_unknown() not in _INTERRUPTED:
                self.reason = f"the solver gives up: {self._solver.reason_unknown()}"
                return None
        if answer != self._z3.sat:
            return None
        model = self._solver.model()
        return frozenset(int(name.name()[1:]) for name in model.decls() if self._z3.is_true(model[name]))
