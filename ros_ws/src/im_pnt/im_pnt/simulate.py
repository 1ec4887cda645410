"""Playing nets by their structure alone: actions end at once, successfully or not, as the dice say."""

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from im_pnt.analysis.compose import compose
from im_pnt.analysis.reachability import at_rest_test
from im_pnt.compiled import compile_net
from im_pnt.net import Net, Role

FAILURE_PROBABILITY = 0.1
"""How often an imagined action fails."""


@dataclass(frozen=True, slots=True)
class Step:
    """One firing of a simulation and the marking after it."""

    transition: str
    marking: dict[str, int]


def simulate(nets: Sequence[Net], *, seed: int = 0, steps: int = 100) -> Iterator[Step]:
    """Plays nets composed with their environment.

    Args:
        nets: The nets.
        seed: The same seed gives the same run.
        steps: Firings at most.

    Yields:
        Each firing; ends early where nothing can fire.

    Raises:
        NetError: The nets do not fit together.
    """
    composition = compose(nets)
    compiled = compile_net(composition.net)
    at_rest = at_rest_test(composition, compiled)
    dice = random.Random(seed)
    transitions = tuple(composition.net.transitions.values())
    marking = compiled.marking_vector(composition.net.initial_marking())
    for _ in range(steps):
        resting = at_rest(marking)
        enabled = [
            index
            for index, transition in enumerate(transitions)
            if compiled.enabled(marking, index) and (resting or transition.name not in composition.at_rest_only)
        ]
        internal = [index for index in enabled if transitions[index].name not in composition.external]
        choices = internal or enabled
        if not choices:
            return
        best = max(transitions[index].priority for index in choices)
        choices = [index for index in choices if transitions[index].priority == best]
        weights = [FAILURE_PROBABILITY if transitions[index].role is Role.FAILED else 1.0 for index in choices]
        index = dice.choices(choices, weights)[0]
        marking = compiled.fire(marking, index)
        yield Step(transitions[index].name, compiled.marking(marking))
