"""The marking of a net in execution, and what each token carries."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence

from im_pnt.compiled import Compiled
from im_pnt.enabling import Enabling
from im_pnt.jobs import NO_LINEAGE, Job, Lineage


class Tokens:
    """Tokens, first in first out on each place; lineages are kept only on places where a token has one.

    Args:
        compiled: The expanded net.
        free: Transitions that fire when enabled.
        initial: Tokens of each place to begin with.
        merge: Makes one lineage of those of several tokens.

    Attributes:
        enabling: Tokens of each place, and what they enable.
        queues: For each place that has a token with a lineage, the lineages of all its tokens in order.
    """

    def __init__(
        self,
        compiled: Compiled,
        free: Collection[int],
        initial: Sequence[int],
        merge: Callable[[Iterable[Lineage]], Lineage],
    ) -> None:
        self.enabling = Enabling(compiled, free, initial)
        self.queues: dict[int, deque[Lineage]] = {}
        self._compiled = compiled
        self._named: dict[int, int] = {}
        self._merge = merge

    def put(self, place: int, count: int, lineage: Lineage) -> None:
        """Puts tokens on a place."""
        queue = self.queues.get(place)
        if queue is None and lineage is not NO_LINEAGE and lineage != NO_LINEAGE:
            queue = self.queues[place] = deque([NO_LINEAGE] * self.enabling.tokens[place])
        if queue is not None:
            queue.extend([lineage] * count)
            if lineage != NO_LINEAGE:
                self._named[place] = self._named.get(place, 0) + count
        self.enabling.add(place, count)

    def take_inputs(self, transition: int) -> Lineage:
        """Takes the input tokens of an enabled transition; returns what they carried."""
        taken: list[Lineage] = []
        for place, weight in self._compiled.inputs[transition]:
            queue = self.queues.get(place)
            if queue is not None:
                first = [queue.popleft() for _ in range(weight)]
                taken.extend(first)
                self._named[place] -= sum(lineage != NO_LINEAGE for lineage in first)
                self._shorten(place)
            self.enabling.take(place, weight)
        return self._merge(taken)

    def peek_inputs(self, transition: int) -> Lineage:
        """Returns what the tokens carry that an enabled transition would take."""
        return self._merge(
            self.queues[place][number]
            for place, weight in self._compiled.inputs[transition]
            if place in self.queues
            for number in range(weight)
        )

    def first(self, place: int) -> Lineage:
        """Returns what the first token of a marked place carries."""
        queue = self.queues.get(place)
        return NO_LINEAGE if queue is None else queue[0]

    def give_outputs(self, transition: int, lineage: Lineage) -> None:
        """Marks the output places of a transition."""
        for place, weight in self._compiled.outputs[transition]:
            self.put(place, weight, lineage)

    def forget_jobs(self, is_open: Callable[[Job], bool]) -> None:
        """Takes the jobs that have ended from the lineages; nobody asks for them any more."""
        for place, queue in list(self.queues.items()):
            for number, (job, failure) in enumerate(queue):
                if job is not None and not is_open(job):
                    queue[number] = Lineage(None, failure)
                    self._named[place] -= failure is None
            self._shorten(place)

    def marking(self) -> dict[str, int]:
        """Returns the marked places by name."""
        return self._compiled.marking(tuple(self.enabling.tokens))

    def _shorten(self, place: int) -> None:
        if not self._named[place]:
            del self.queues[place], self._named[place]
