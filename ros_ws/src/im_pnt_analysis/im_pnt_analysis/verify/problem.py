"""The problem of all methods of verification: composed nets in indices, and for some the same nets with a stop.

Nets that wait for a symbol at rest enable something and are not stuck; nets that wait away from rest enable something
and are. Methods that know dead markings only are given nets that may stop at any marking, for good. What then still can
fire, changing nothing, is what they would do by themselves, and, at rest, what they wait for; a stopped marking is dead
exactly if the nets are stuck in it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.net import Net, Place, Transition
from im_pnt.verification import Counterexample
from im_pnt_analysis.composition.compose import Composition, compose
from im_pnt_analysis.composition.precedence import with_precedence
from im_pnt_analysis.guards.coverage import settled_choices

DOES, WAITS = 1, 2
"""Kinds of transitions: what the nets do by themselves, and what they may wait for."""


@dataclass(frozen=True, slots=True)
class Problem:
    """Composed nets in indices.

    Attributes:
        nets: The nets as given.
        composition: The nets and their environment.
        compiled: The composition in indices.
        initial: Tokens of each place at first.
        kinds: For each transition whether the nets do it (DOES) or wait for it (WAITS); 0: nobody can count on it.
        busy: Places that hold no token at rest.
        may_end: Whether the nets may come to an end at rest.
        names: For transitions that are one way to fire another the name of that, by which firing sequences go.
    """

    nets: tuple[Net, ...]
    composition: Composition
    compiled: Compiled
    initial: tuple[int, ...]
    kinds: tuple[int, ...]
    busy: tuple[int, ...]
    may_end: bool
    names: Mapping[str, str]

    @property
    def ways(self) -> dict[str, tuple[int, ...]]:
        """Ways of each transition of the nets in the composition, by the numbers."""
        ways: dict[str, tuple[int, ...]] = {}
        for number, name in enumerate(self.compiled.transitions):
            meant = self.composition.ways.get(name, name)
            if name not in self.composition.watching:
                ways[meant] = (*ways.get(meant, ()), number)
        return ways

    def in_names(self, refusal: Counterexample) -> Counterexample:
        """Return a refusal with the firings under the names that they have in the nets."""
        sequence, repeat = (
            tuple(self.names.get(each, each) for each in part) for part in (refusal.sequence, refusal.repeat)
        )
        return replace(refusal, sequence=sequence, repeat=repeat)

    def is_beyond(self, marking: Mapping[str, int]) -> bool:
        """Return whether an emptied place exceeds the capacity: later firings are not explored."""
        places = self.composition.net.places
        return any(marking.get(name, 0) > (places[name].capacity or 0) for name in self.composition.emptied)

    @property
    def closed(self) -> bool:
        """Whether a marking is stuck exactly if no transition is enabled."""
        return not self.composition.external and not self.may_end


def problem_of(nets: Sequence[Net]) -> Problem:
    """Compose nets.

    Raises:
        NetError: The nets do not fit together.
    """
    settled = [settled_choices(net) for net in nets]
    precedence = with_precedence(compose(settled), settled)
    composition = precedence.composition
    compiled = compile_net(composition.net)
    waits = composition.external - composition.disturbances
    kinds = {name: DOES for name in compiled.transitions if name not in composition.external}
    kinds.update(dict.fromkeys(waits, WAITS))
    return Problem(
        tuple(nets),
        composition,
        compiled,
        compiled.marking_vector(composition.net.initial_marking()),
        tuple(kinds.get(name, 0) for name in compiled.transitions),
        tuple(i for i, name in enumerate(compiled.places) if name not in composition.rest),
        composition.may_end and not waits,
        precedence.names,
    )


_GOES, _STOPPED = "goes on", "has stopped"


def stopping(problem: Problem) -> tuple[Compiled, tuple[int, ...]]:
    """Return nets with a stop, and the first marking."""
    net = problem.compiled.net
    places = {**net.places, _GOES: Place(_GOES, tokens=1), _STOPPED: Place(_STOPPED)}
    transitions = {transition.name: transition for transition in _transitions(problem)}
    return compile_net(replace(net, places=places, transitions=transitions)), (*problem.initial, 1, 0)


def _transitions(problem: Problem) -> Iterator[Transition]:
    at_rest = {problem.compiled.places[place]: 1 for place in problem.busy}
    stopped = {_STOPPED: 1}
    for transition, kind in zip(problem.compiled.net.transitions.values(), problem.kinds, strict=True):
        outputs = {**transition.outputs, _GOES: 1}
        yield replace(transition, inputs={**transition.inputs, _GOES: 1}, outputs=outputs)
        if kind in (DOES, WAITS):
            needs = {**transition.inputs, **stopped}
            inhibitors = {**transition.inhibitors, **(at_rest if kind == WAITS else {})}
            yield Transition(f"{transition.name} could fire", needs, needs, inhibitors=inhibitors)
    yield Transition(_STOPPED, {_GOES: 1}, stopped)
    if problem.may_end:
        yield Transition("rests", stopped, stopped, inhibitors=at_rest)


def without_stop(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return a firing sequence of nets with a stop as a sequence of the original nets."""
    return tuple(name for name in names if name != _STOPPED)


def without_marks(marking: dict[str, int]) -> dict[str, int]:
    """Return a marking of nets with a stop as a marking of the original nets."""
    return {place: tokens for place, tokens in marking.items() if place not in (_GOES, _STOPPED)}
