"""Which of several contending transitions fires: priority, then weight and probability of success, with a seed.

Contention is local. A transition that has become enabled contends with the enabled transitions that share an input
place with it, and the winner, in turn, only with those of its own rivals that have a higher priority.
"""

import random
from collections.abc import Sequence

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.firing import FiringRule
from im_pnt.functions import ActionContext, Functions, clock_period
from im_pnt.jobs import NO_LINEAGE, Job, Lineage
from im_pnt.net import Transition
from im_pnt.strategies import StrategyBook, entropy, probabilities


class Chooser:
    """Decides about the transitions of an expanded net.

    Args:
        rule: The net, its marking and its jobs.
        functions: Registered guards.
        book: What was learned about strategies.
        seed: Seed of the choices.

    Attributes:
        book: As given.
        delayed: Transitions that take their time and have no action.
        certain: Transitions that fire when their tokens let them: nothing contends with them or holds them back.
        ripe: Those of them that have waited long enough.
        barred: Transitions that may not fire now, whatever their tokens; another one looks after them.
        dice: What is drawn with.
        clocks: Sources of guards that are clocks, with their periods [s].
    """

    def __init__(self, rule: FiringRule, functions: Functions, book: StrategyBook, seed: int) -> None:
        self.book = book
        self.ripe: set[int] = set()
        self.barred: frozenset[int] = frozenset()
        self.dice = random.Random()
        self._rule, self._functions, self._seed = rule, functions, seed
        self._enabling, self._transitions = rule.enabling, rule.transitions
        self.delayed = frozenset(i for i, t in enumerate(self._transitions) if t.delay is not None and t.action is None)
        self._rank = [(i not in self.delayed, t.priority) for i, t in enumerate(self._transitions)]
        self._flat = len(set(self._rank)) <= 1
        self.certain = frozenset(
            index
            for index, transition in enumerate(self._transitions)
            if transition.guard is None
            and transition.symbol is None
            and index not in self.delayed
            and not self._enabling.contended[index]
        )
        self._even = all(t.weight == 1.0 and t.strategy is None for t in self._transitions)
        self._verdicts: dict[tuple[str, int], bool] = {}
        self._stalled_for: dict[int, set[int]] = {}
        self._sources: dict[str, list[int]] = {}
        self._undeclared: set[int] = set()
        for index, transition in enumerate(self._transitions):
            if transition.guard is not None:
                declared = functions.sources(transition.guard.name)
                if declared is None:
                    self._undeclared.add(index)
                for source in declared or ():
                    self._sources.setdefault(source, []).append(index)
        periods = ((source, clock_period(source)) for source in self._sources)
        self.clocks = {source: period for source, period in periods if period is not None}
        self.reseed(0)

    def reseed(self, sequence: int) -> None:
        """Begins a repeatable series of choices: at the start, or after so many firings."""
        self.dice.seed(f"{self._seed}:{self._rule.net.name}:{sequence}")

    def wake(self, source: str) -> None:
        """Has guards asked again: those that declare a source; for an empty one, all."""
        enabling = self._enabling
        enabling.consider_stalled(self._sources.get(source, ()) if source else list(enabling.stalled))

    def wake_undeclared(self) -> None:
        """Has those guards asked again that do not say what wakes them."""
        if self._undeclared and self._enabling.stalled:
            self._enabling.consider_stalled(self._enabling.stalled & self._undeclared)

    def stalls(self, source: str) -> bool:
        """Whether a guard that a source wakes holds an enabled transition back."""
        return any(index in self._enabling.stalled for index in self._sources[source])

    def wake_job(self, job: Job) -> None:
        """Has those guards asked again that were asked about a job."""
        self._enabling.consider_stalled(self._stalled_for.pop(job.number, ()))

    def choose(self, index: int) -> int | None:
        """Decides about an enabled transition and its rivals; each guard is evaluated at most once.

        Returns:
            The one that is to fire, None where guards and symbols hold all of them back.
        """
        self._verdicts.clear()
        rivals = self._enabling.rivals(index)
        if not rivals:
            return index if self.eligible(index) else None
        rank = self._rank
        may = self.eligible if self.barred or self.delayed else self._lets
        candidates = list(filter(may, (index, *rivals)))
        if self._flat and len(candidates) == 1:
            return candidates[0]
        while candidates:
            best = max(rank[i] for i in candidates)
            top = [i for i in candidates if rank[i] == best]
            winner = top[0] if len(top) == 1 else self.draw(top)
            candidates = [i for i in self._enabling.rivals(winner) if rank[i] > best and may(i)]
            if not candidates:
                self._tell(top, winner)
                return winner
        return None

    def may_fire(self, index: int) -> bool:
        """Whether a transition could be chosen by a decision of its own: eligible, and no rival goes first."""
        self._verdicts.clear()
        rank = self._rank
        if self._enabling.unmet[index] or not self.eligible(index):
            return False
        return not any(rank[i] > rank[index] and self.eligible(i) for i in self._enabling.rivals(index))

    def holds(self, index: int) -> bool:
        """Whether symbol and guard of a transition let it fire, its delay aside."""
        self._verdicts.clear()
        return self._lets(index)

    def eligible(self, index: int) -> bool:
        """Whether a transition that its arcs enable may take part in the present decision."""
        if index in self.barred or (index in self.delayed and index not in self.ripe):
            return False
        return self._lets(index)

    def _lets(self, index: int) -> bool:
        transition = self._transitions[index]
        if transition.symbol is not None and not self._rule.ledger.tape.has(transition.symbol):
            return False
        if transition.guard is None:
            return True
        tokens = self._rule.tokens
        lineage = tokens.peek_inputs(index) if tokens.queues or self._rule.ledger.serving else NO_LINEAGE
        if transition.symbol is not None:
            lineage = Lineage(self._rule.ledger.tape.first(transition.symbol), lineage.failure)
        key = (transition.guard.name, id(lineage.job))
        verdict = self._verdicts.get(key)
        if verdict is None:
            verdict = self._verdicts[key] = self._ask_guard(transition, lineage)
        if verdict == transition.guard.negated:
            self._enabling.stalled.add(index)
            if lineage.job is not None:
                self._stalled_for.setdefault(lineage.job.number, set()).add(index)
            return False
        return True

    def draw(self, contending: Sequence[int]) -> int:
        """Takes one of several transitions by weight and probability of success."""
        if self._even:
            return contending[int(self.dice.random() * len(contending))]
        weights = [self._weight(index) for index in contending]
        point = self.dice.random() * sum(weights)
        for index, weight in zip(contending, weights, strict=True):
            point -= weight
            if point < 0.0:
                return index
        return contending[-1]

    def _weight(self, index: int) -> float:
        transition = self._transitions[index]
        if transition.strategy is None:
            return transition.weight
        return transition.weight * self.book.mean_success(self._rule.net.name, transition.origin, transition.strategy)

    def _tell(self, top: Sequence[int], winner: int) -> None:
        if len(top) < 2 or not any(self._transitions[i].strategy is not None for i in top):
            return
        distribution = probabilities([self._weight(index) for index in top])
        others = [self._transitions[i].inputs for i in top if i != winner]
        taken = self._transitions[winner]
        self._rule.teller.chose(
            tuple(place for place in taken.inputs if any(place in inputs for inputs in others)),
            {self._transitions[i].origin: p for i, p in zip(top, distribution, strict=True)},
            entropy(distribution),
            taken.origin,
        )

    def _ask_guard(self, transition: Transition, lineage: Lineage) -> bool:
        assert transition.guard is not None
        name = transition.guard.name
        context = ActionContext(self._rule.net.name, transition.origin, lineage, progress=self._rule.teller.progressed)
        try:
            return bool(self._functions.guards[name](context))
        except Exception as error:  # a guard is foreign code: whatever it raises must not stop the net
            failure = error if isinstance(error, ImError) else NetError(f"guard {name} failed: {error!r}", guard=name)
            if lineage.job is not None:
                self._rule.guard_broke(lineage.job, failure)
            self._rule.teller.troubled(f"guard {name} counts as false: {failure}")
            return False
