"""Being stuck told as being dead, for methods that know dead markings only.

Nets that wait for a symbol at rest enable something and are not stuck; nets that wait away from rest enable something
and are. Here the nets may stop at any marking, for good. What then still can fire, changing nothing, is what they would
do by themselves, and, at rest, what they wait for; a stopped marking is dead exactly if the nets are stuck in it.
"""

from collections.abc import Iterator
from dataclasses import replace

from im_pnt.analysis.problem import DOES, WAITS, Problem
from im_pnt.compiled import Compiled, compile_net
from im_pnt.net import Place, Transition

_GOES, _STOPPED = "goes on", "has stopped"


def stopping(problem: Problem) -> tuple[Compiled, tuple[int, ...]]:
    """Returns nets that may stop, and their first marking.

    Args:
        problem: The nets.
    """
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
    """Returns a firing sequence of nets that may stop as one of the nets themselves."""
    return tuple(name for name in names if name != _STOPPED)


def without_marks(marking: dict[str, int]) -> dict[str, int]:
    """Returns a marking of nets that may stop as one of the nets themselves."""
    return {place: tokens for place, tokens in marking.items() if place not in (_GOES, _STOPPED)}
