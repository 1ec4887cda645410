"""Enabled transitions, updated by the changes of a firing and nothing else.

Each transition counts its unmet inputs; a place that crosses an arc's weight changes the counters of its neighbours
only, so that the cost of a firing does not grow with the net. A transition that becomes enabled is put on the agenda,
and stays there while it is enabled, except where something else than tokens holds it back (a guard, a symbol, a clock,
the operator): then whatever that is puts it there again.
"""

from collections import Counter, deque
from collections.abc import Collection, Iterable, Sequence

from im_pnt.execution.jobs import NO_LINEAGE, Job, Lineage
from im_pnt.model.compiled import Compiled, IndexedArcs


class Enabling:
    """Tokens, counters of unmet inputs, and the candidate transitions.

    Args:
        compiled: The expanded net.
        free: Transitions that fire when enabled; the others (end, failed, withdrawn, ...) wait for an event.
        tokens: Tokens of each place to begin with.

    Attributes:
        compiled: The expanded net.
        tokens: Tokens of each place.
        unmet: For each free transition the number of input and inhibitor arcs that hold it back.
        agenda: Transitions to decide about, in order.
        listed: For each transition whether it is on the agenda; always, for those that are not free.
        contended: For each free transition the free consumers of each of its input places that has several.
        stalled: Enabled transitions that only their guards hold back, and those whose clocks run while their guards let
            them; tokens that come or go wake them.
        clocks: Transitions with a delay whose time runs.
        crossed: Those of them that a firing has disabled, perhaps only for its own duration.
    """

    def __init__(self, compiled: Compiled, free: Collection[int], tokens: Collection[int]) -> None:
        self.compiled = compiled
        self.tokens = [0] * len(compiled.places)
        self.unmet = [len(inputs) for inputs in compiled.inputs]
        self.agenda: deque[int] = deque()
        self.listed = [True] * len(compiled.transitions)
        for transition in free:
            self.listed[transition] = False
        self._consumers = [self._free_of(row) for row in compiled.consumers]
        self._inhibited = [self._free_of(row) for row in compiled.inhibited]
        sharing = [tuple(t for t, _ in row) for row in self._consumers]
        contended = [
            tuple(sharing[place] for place, _ in inputs if len(sharing[place]) > 1) for inputs in compiled.inputs
        ]
        self.contended = tuple(() if self.listed[t] else sharing for t, sharing in enumerate(contended))
        self.stalled: set[int] = set()
        self.clocks: set[int] = set()
        self.crossed: list[int] = []
        for transition in free:
            if not compiled.inputs[transition]:
                self.consider(transition)
        for place, count in enumerate(tokens):
            self.add_tokens(place, count)

    def _free_of(self, arcs: IndexedArcs) -> IndexedArcs:
        return tuple((transition, weight) for transition, weight in arcs if not self.listed[transition])

    def add_tokens(self, place: int, count: int) -> None:
        """Put tokens on a place."""
        before = self.tokens[place]
        after = before + count
        self.tokens[place] = after
        unmet = self.unmet
        for transition, weight in self._consumers[place]:
            if before < weight <= after:
                left = unmet[transition] - 1
                unmet[transition] = left
                if not left and not self.listed[transition]:  # it was disabled, so it is not stalled
                    self.listed[transition] = True
                    self.agenda.append(transition)
            elif transition in self.stalled:
                self.consider(transition)
        for transition, weight in self._inhibited[place]:
            if before < weight <= after:
                unmet[transition] += 1
                if transition in self.clocks:
                    self.crossed.append(transition)
                self.stalled.discard(transition)

    def take_tokens(self, place: int, count: int) -> None:
        """Take tokens from a place with enough tokens."""
        before = self.tokens[place]
        after = before - count
        self.tokens[place] = after
        unmet = self.unmet
        for transition, weight in self._consumers[place]:
            if after < weight <= before:
                unmet[transition] += 1
                if transition in self.clocks:
                    self.crossed.append(transition)
                self.stalled.discard(transition)
            elif transition in self.stalled:
                self.consider(transition)
        for transition, weight in self._inhibited[place]:
            if after < weight <= before:
                unmet[transition] -= 1
                if not unmet[transition]:
                    self.consider(transition)

    def consider(self, transition: int) -> None:
        """Ask for a decision on a transition."""
        self.stalled.discard(transition)
        if not self.listed[transition]:
            self.listed[transition] = True
            self.agenda.append(transition)

    def consider_stalled(self, transitions: Iterable[int]) -> None:
        """Ask for a decision on the transitions held back by the guards among some."""
        for transition in transitions:
            if transition in self.stalled:
                self.consider(transition)

    def allows(self, transition: int) -> bool:
        """Tell whether the arcs of a transition, free or not, let the transition fire."""
        return self.compiled.enabled(self.tokens, transition)

    def next_candidate(self) -> int | None:
        """Take the next enabled candidate, None without one."""
        while self.agenda:
            transition = self.agenda.popleft()
            self.listed[transition] = False
            if not self.unmet[transition] and transition not in self.stalled:
                return transition
        return None

    def rivals(self, transition: int) -> list[int]:
        """Return the free transitions with a common input place and enabled arcs."""
        contended, unmet = self.contended[transition], self.unmet
        if not contended:
            return []
        found: list[int] = []
        for sharing in contended:
            for rival in sharing:
                if not unmet[rival] and rival != transition:
                    found.append(rival)  # noqa: PERF401 - a comprehension is a call more
        return list(dict.fromkeys(found)) if len(contended) > 1 else found


_NOBODY: tuple[Job | None, ...] = (None,)


class Tokens:
    """Tokens, first in first out on each place; lineages are kept only on places where a token has one.

    A token belongs to one job, or to nobody, as do all on places of resources. A firing takes tokens of one job at
    most, beside those of nobody.

    Args:
        compiled: The expanded net.
        free: Transitions that fire when enabled.
        initial: Tokens of each place to begin with.
        resources: Places whose tokens belong to nobody.

    Attributes:
        compiled: As given.
        enabling: Tokens of each place, and what they enable.
        queues: For each place that has a token with a lineage, the lineages of all its tokens in order.
        choosy: Transitions that take several tokens which may belong to somebody: tokens alone do not enable them.
    """

    def __init__(
        self, compiled: Compiled, free: Collection[int], initial: Sequence[int], resources: Collection[int]
    ) -> None:
        self.enabling = Enabling(compiled, free, initial)
        self.queues: dict[int, deque[Lineage]] = {}
        self.compiled = compiled
        self._named: dict[int, int] = {}
        self._carries = [place not in resources for place in range(len(compiled.places))]
        self._carriers = [tuple(arc for arc in inputs if self._carries[arc[0]]) for inputs in compiled.inputs]
        self.choosy = frozenset(t for t, arcs in enumerate(self._carriers) if sum(weight for _, weight in arcs) > 1)

    def put_tokens(self, place: int, count: int, lineage: Lineage) -> None:
        """Put tokens on a place."""
        queue = self.queues.get(place)
        named = self._carries[place] and (lineage.job is not None or lineage.failure is not None)
        if named and queue is None:
            queue, self._named[place] = deque([NO_LINEAGE] * self.enabling.tokens[place]), 0
            self.queues[place] = queue
        if queue is not None:
            queue.extend([lineage] * count)
            if named:
                self._named[place] += count
        self.enabling.add_tokens(place, count)

    def carries(self, place: int) -> bool:
        """Return whether tokens on a place may belong to a job: the place is no resource."""
        return self._carries[place]

    def owners(self, transition: int) -> Sequence[Job | None]:
        """Return the possible jobs of a transition enabled by the arcs, oldest token first; None: no job."""
        queues = [queue for place, _ in self._carriers[transition] if (queue := self.queues.get(place)) is not None]
        if not queues:
            return _NOBODY
        if len(queues) == 1 and len(queues[0]) == 1:
            return (queues[0][0].job,)
        oldest = list(dict.fromkeys(lineage.job for queue in queues for lineage in queue))
        if transition not in self.choosy or len(oldest) == 1:
            return oldest
        held = [
            (Counter(lineage.job for lineage in self.queues[place]), weight)
            for place, weight in self._carriers[transition]
            if place in self.queues
        ]
        return [
            owner
            for owner in oldest
            if all(own[owner] + (own[None] if owner is not None else 0) >= weight for own, weight in held)
        ]

    def take_inputs(self, transition: int, owner: Job | None) -> Lineage:
        """Take the input tokens of an enabled transition: tokens of a job, and free ones where the job has none.

        The places that it empties are places of resources, whose tokens are nobody's.

        Args:
            transition: The transition.
            owner: One of :meth:`owners`.

        Returns:
            The job, and the first failure that its tokens carried.
        """
        lineage = NO_LINEAGE
        for place, weight in self.compiled.inputs[transition]:
            queue = self.queues.get(place)
            if queue is not None:
                if weight == 1 and queue[0].job is owner:
                    picked = [queue.popleft()]
                else:
                    picked = self._pick(queue, weight, owner)
                for each in picked:
                    job, why = each
                    if job is not None or why is not None:
                        self._named[place] -= 1
                    if job is owner and lineage.failure is None:
                        lineage = each
                if not self._named[place]:
                    del self.queues[place], self._named[place]
            self.enabling.take_tokens(place, weight)
        for place in self.compiled.resets[transition]:
            self.enabling.take_tokens(place, self.enabling.tokens[place])
        return lineage

    def peek_inputs(self, transition: int, owner: Job | None) -> Lineage:
        """Return the lineage of a firing for a job."""
        lineage = NO_LINEAGE
        for place, weight in self._carriers[transition]:
            left = weight
            for each in self.queues.get(place, ()):
                if each.job is owner and left and lineage.failure is None:
                    lineage = each
                    left -= 1
        return lineage

    def _pick(self, queue: deque[Lineage], count: int, owner: Job | None) -> list[Lineage]:
        """Take the oldest tokens of a job from a queue, and then the oldest free ones."""
        own = [number for number, lineage in enumerate(queue) if lineage.job is owner][:count]
        if len(own) < count:
            spare = (number for number, lineage in enumerate(queue) if lineage.job is None)
            own += [number for number in spare if number not in own]
        picked = [queue[number] for number in own[:count]]
        for number in sorted(own[:count], reverse=True):
            del queue[number]
        return picked

    def drop(self, job: Job) -> None:
        """Take the tokens of a job out of the net."""
        for place, queue in list(self.queues.items()):
            kept = deque(lineage for lineage in queue if lineage.job is not job)
            if count := len(queue) - len(kept):
                self.queues[place] = kept
                self._named[place] -= count
                if not self._named[place]:
                    del self.queues[place], self._named[place]
                self.enabling.take_tokens(place, count)

    def disown(self, job: Job) -> None:
        """Free the tokens of an ended job, and decide again on the transitions enabled by the tokens."""
        for place, queue in list(self.queues.items()):
            mine = [number for number, lineage in enumerate(queue) if lineage.job is job]
            for number in mine:
                queue[number] = NO_LINEAGE
            if mine:
                self._named[place] -= len(mine)
                if not self._named[place]:
                    del self.queues[place], self._named[place]
                self.enabling.consider_stalled(t for t, _ in self.compiled.consumers[place])

    def first(self, place: int) -> Lineage:
        """Return the lineage of the first token of a marked place."""
        queue = self.queues.get(place)
        return NO_LINEAGE if queue is None else queue[0]

    def give_outputs(self, transition: int, lineage: Lineage) -> None:
        """Mark the output places of a transition."""
        for place, weight in self.compiled.outputs[transition]:
            self.put_tokens(place, weight, lineage)

    def marking(self) -> dict[str, int]:
        """Return the marked places by name."""
        return self.compiled.marking(tuple(self.enabling.tokens))
