"""What all methods of verification work on."""

from collections.abc import Sequence
from dataclasses import dataclass

from im_pnt.analysis.compose import Composition, compose
from im_pnt.compiled import Compiled, compile_net
from im_pnt.net import Net

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
    """

    nets: tuple[Net, ...]
    composition: Composition
    compiled: Compiled
    initial: tuple[int, ...]
    kinds: tuple[int, ...]
    busy: tuple[int, ...]
    may_end: bool

    @property
    def closed(self) -> bool:
        """Whether a marking is stuck exactly if it enables nothing."""
        return not self.composition.external and not self.may_end


def problem_of(nets: Sequence[Net]) -> Problem:
    """Composes nets.

    Args:
        nets: Nets as written or expanded.

    Raises:
        NetError: The nets do not fit together.
    """
    composition = compose(nets)
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
    )
