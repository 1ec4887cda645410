"""The marking of a net in execution, and what each token carries."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence

from im_pnt.compiled import Compiled
from im_pnt.enabling import Enabling
from im_pnt.jobs import NO_LINEAGE, Lineage


class Tokens:
    """Tokens with their lineages, first in first out on each place.

    Args:
        compiled: The expanded net.
        free: Transitions that fire when enabled.
        initial: Tokens of each place to begin with.
        merge: Makes one lineage of those of several tokens.
    """

    def __init__(
        self,
        compiled: Compiled,
        free: Collection[int],
        initial: Sequence[int],
        merge: Callable[[Iterable[Lineage]], Lineage],
    ) -> None:
        self.enabling = Enabling(compiled, free, initial)
        self._compiled = compiled
        self._merge = merge
        self._lineages = [deque([NO_LINEAGE] * count) for count in initial]

    def put(self, place: int, count: int, lineage: Lineage) -> None:
        """Puts tokens on a place."""
        self._lineages[place].extend([lineage] * count)
        self.enabling.add(place, count)

    def take_one(self, place: int, lineage: Lineage) -> None:
        """Takes the token with a given lineage from a place."""
        self._lineages[place].remove(lineage)
        self.enabling.take(place, 1)

    def take_inputs(self, transition: int) -> Lineage:
        """Takes the input tokens of an enabled transition; returns what they carried."""
        taken: list[Lineage] = []
        for place, weight in self._compiled.inputs[transition]:
            waiting = self._lineages[place]
            taken.extend(waiting.popleft() for _ in range(weight))
            self.enabling.take(place, weight)
        return self._merge(taken)

    def peek_inputs(self, transition: int) -> Lineage:
        """Returns what the tokens carry that an enabled transition would take."""
        return self._merge(
            self._lineages[place][number]
            for place, weight in self._compiled.inputs[transition]
            for number in range(weight)
        )

    def first(self, place: int) -> Lineage:
        """Returns what the first token of a marked place carries."""
        return self._lineages[place][0]

    def give_outputs(self, transition: int, lineage: Lineage) -> None:
        """Marks the output places of a transition."""
        for place, weight in self._compiled.outputs[transition]:
            self.put(place, weight, lineage)

    def marking(self) -> dict[str, int]:
        """Returns the marked places by name."""
        return self._compiled.marking(tuple(self.enabling.tokens))
