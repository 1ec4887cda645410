"""Conflict resolution: which of several contending transitions fires.

Priority decides first, then weight and probability of success, with a seed. Contention is local: a transition that has
become enabled contends with the enabled transitions that share an input place with it, and the winner, in turn, only
with those of its own rivals that have a higher priority. Delays of transitions without action are a race before that
(GSPN: race, enabling memory, as many servers as the transition has).

Strategies are contending ways to do a thing (:mod:`.strategies`). Each is taken with the probability that it costs
least until it succeeds; the cost is its ``delay`` over its ``weight``. The entropy of that choice is the uncertainty of
the decision in the sense of Saridis' entropy formulation [nats]. Where transitions without strategy contend, too, they
keep the share that their weights have.
"""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace

from im_core.errors import FOREIGN, ImError
from im_pnt.errors import NetError
from im_pnt.execution.firing.entries import happens
from im_pnt.execution.firing.rule import FiringRule
from im_pnt.execution.functions import ActionContext, Functions, clock_period
from im_pnt.execution.jobs import NO_LINEAGE, Job, Lineage
from im_pnt.execution.journal_entries import GuardBroke
from im_pnt.execution.marking import Enabling
from im_pnt.execution.notification import StrategyChosen
from im_pnt.execution.strategies import DONE, StrategyBook, StrategyOutcome, chances_of_best, strategy_name
from im_pnt.execution.timers import Timer, Timers
from im_pnt.execution.values import ObjectPendingError
from im_pnt.expression.evaluation import as_text
from im_pnt.model.net import Strategy, Transition


def probabilities(weights: Sequence[float]) -> list[float]:
    """Return the probabilities of a choice, equal where all weights are 0.

    Args:
        weights: Relative frequencies, >= 0.
    """
    total = math.fsum(weights)
    return [weight / total for weight in weights] if total > 0.0 else [1.0 / len(weights)] * len(weights)


def entropy(distribution: Sequence[float]) -> float:
    """Return the entropy of a distribution [nats]."""
    return -math.fsum(p * math.log(p) for p in distribution if p > 0.0) + 0.0


class ConflictResolution:
    """Decides about the transitions of an expanded net.

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
        self.drawn: Callable[[Sequence[str]], int] | None = None
        self.dice = random.Random()
        self._random = self.dice.random
        self._rule, self._seed = rule, seed
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
            and index not in rule.choosy
        )
        self._tokens = rule.tokens
        self._conditions = any(t.guard is not None or t.symbol is not None for t in self._transitions)
        self._owners: dict[int, Job | None] = {}
        asked = dict.fromkeys(replace(t.guard, negated=False) for t in self._transitions if t.guard is not None)
        numbers = {guard: number for number, guard in enumerate(asked)}
        self._questions = [functions.question(guard) for guard in asked]
        self._conditions_of: list[tuple[str | None, int | None, bool, tuple[int, int]]] = []
        for symbol, guard in ((t.symbol, t.guard) for t in self._transitions):
            number = None if guard is None else numbers[replace(guard, negated=False)]
            self._conditions_of.append((symbol, number, guard is not None and guard.negated, (number or 0, id(None))))
        self._strategies = any(t.strategy is not None for t in self._transitions)
        self._even = all(t.weight == 1.0 and t.strategy is None for t in self._transitions)
        self._verdicts: dict[tuple[int, int], bool | None] = {}
        self._sources: dict[str, list[int]] = {}
        self._undeclared: set[int] = set()
        for index, transition in enumerate(self._transitions):
            if transition.guard is not None:
                declared = functions.sources(transition.guard)
                if declared is None:
                    self._undeclared.add(index)
                for source in declared or ():
                    self._sources.setdefault(source, []).append(index)
        periods = ((source, clock_period(source)) for source in self._sources)
        self.clocks = {source: period for source, period in periods if period is not None}
        self.reseed(0)

    def reseed(self, sequence: int) -> None:
        """Begin a repeatable series of choices: at the start, or after a number of firings."""
        self.dice.seed(f"{self._seed}:{self._rule.net.name}:{sequence}")

    def wake(self, source: str) -> None:
        """Ask guards again with a declared source; all for an empty one."""
        enabling = self._enabling
        enabling.consider_stalled(self._sources.get(source, ()) if source else list(enabling.stalled))

    def wake_undeclared(self) -> None:
        """Ask the guards without a declared source again."""
        if self._undeclared and self._enabling.stalled:
            self._enabling.consider_stalled(self._enabling.stalled & self._undeclared)

    def stalls(self, source: str) -> bool:
        """Return whether a guard with a source holds an enabled transition back."""
        return any(index in self._enabling.stalled for index in self._sources[source])

    def wake_job(self, job: Job) -> None:
        """Ask the guards about a job again."""
        if job.stalled:
            stalled, job.stalled = job.stalled, set()
            self._enabling.consider_stalled(stalled)

    def choose(self, index: int) -> int | None:
        """Decide on an enabled transition and the rivals; each guard is evaluated at most once.

        Returns:
            The one that is to fire, None where guards and symbols hold all of them back.
        """
        self._begin_decision()
        rivals = self._enabling.rivals(index)
        if not rivals:
            return index if self.eligible(index) else None
        candidates = [index, *rivals]
        may = self.eligible if self.barred or self.delayed else self._lets
        if self._conditions or self.barred or self.delayed or self._tokens.queues:
            candidates = list(filter(may, candidates))
        if self._flat:
            winner = candidates[0] if len(candidates) == 1 else self.draw(candidates) if candidates else None
            if winner is not None and self._strategies:
                self._tell(candidates, winner)
            return winner
        rank = self._rank
        while candidates:
            best = max(rank[i] for i in candidates)
            top = [i for i in candidates if rank[i] == best]
            winner = top[0] if len(top) == 1 else self.draw(top)
            candidates = [i for i in self._enabling.rivals(winner) if rank[i] > best and may(i)]
            if not candidates:
                self._tell(top, winner)
                return winner
        return None

    def _begin_decision(self) -> None:
        self._verdicts.clear()
        self._owners.clear()

    def may_fire(self, index: int) -> bool:
        """Return whether a decision on a transition alone could choose the transition: eligible, and no rival first."""
        self._begin_decision()
        rank = self._rank
        if self._enabling.unmet[index] or not self.eligible(index):
            return False
        return not any(rank[i] > rank[index] and self.eligible(i) for i in self._enabling.rivals(index))

    def holds(self, index: int) -> bool:
        """Return whether symbol and guard of a transition allow the firing, the delay aside."""
        self._begin_decision()
        return self._lets(index)

    def eligible(self, index: int) -> bool:
        """Return whether a transition enabled by the arcs may take part in the present decision."""
        if index in self.barred or (index in self.delayed and index not in self.ripe):
            return False
        return self._lets(index)

    def _lets(self, index: int) -> bool:
        symbol, guard, negated, unowned = self._conditions_of[index]
        if symbol is not None and not self._rule.ledger.tape.has(symbol):
            return False
        if not self._tokens.queues and symbol is None and index not in self._rule.cancelling:
            if guard is None or self._passes(index, guard, negated, NO_LINEAGE, unowned):
                return True
        elif self._finds_owner(index, guard, negated):
            return True
        self._enabling.stalled.add(index)
        return False

    def _finds_owner(self, index: int, guard: int | None, negated: bool) -> bool:
        """Return whether the guard of a transition admits a job; keep the job."""
        if guard is None and index not in self._rule.choosy and not self._rule.held:
            return True
        for owner in self._rule.owners(index):
            if guard is not None:
                lineage = self._rule.foreseen(index, owner)
                if not self._passes(index, guard, negated, lineage, (guard, id(lineage.job))):
                    if lineage.job is not None:
                        lineage.job.stalled.add(index)
                    continue
            self._owners[index] = owner
            return True
        return False

    def _passes(self, index: int, guard: int, negated: bool, lineage: Lineage, key: tuple[int, int]) -> bool:
        """Return whether a guard, asserted or negated, admits a job; an undecided guard admits neither."""
        if key not in self._verdicts:
            self._verdicts[key] = self._verdict(index, guard, lineage)
        return self._verdicts[key] is not None and self._verdicts[key] != negated

    def _verdict(self, index: int, guard: int, lineage: Lineage) -> bool | None:
        """Return the verdict of a guard on a job; None: undecided."""
        try:
            return bool(self._questions[guard](self._context(index, lineage)))
        except ObjectPendingError:
            return None
        except FOREIGN as error:  # a guard is foreign code: whatever it raises must not stop the net
            return self._guard_broke(index, lineage, error)

    def owner(self, index: int) -> Job | None:
        """Return the job of the last chosen transition."""
        return self._owners[index] if index in self._owners else self._rule.first_owner(index)

    def draw(self, contending: Sequence[int]) -> int:
        """Draw one of several transitions by weight and probability of success, or as :attr:`drawn` says."""
        if self.drawn is not None:
            return contending[self.drawn([self._transitions[index].name for index in contending])]
        if self._even:
            return contending[int(self._random() * len(contending))]
        weights = self._weights(contending)
        point = self.dice.random() * sum(weights)
        for index, weight in zip(contending, weights, strict=True):
            point -= weight
            if point < 0.0:
                return index
        return contending[-1]

    def _weights(self, contending: Sequence[int]) -> list[float]:
        weights = [self._transitions[index].weight for index in contending]
        places = [place for place, index in enumerate(contending) if self._transitions[index].strategy is not None]
        if len(places) > 1:
            share = math.fsum(weights[place] for place in places)
            chances = chances_of_best([self._prospect(contending[place]) for place in places])
            for place, chance in zip(places, chances, strict=True):
                weights[place] = share * chance
        return weights

    def _prospect(self, index: int) -> tuple[float, float, float]:
        """Return the counts of a strategy, and what a try costs."""
        transition = self._transitions[index]
        assert transition.strategy is not None
        told = self._context(index, self._rule.foreseen(index, self.owner(index)))
        name = self._strategy_name(transition, self.context_of(transition.strategy, told))
        cost = transition.delay.mean if transition.delay is not None else 1.0
        return *self.book.experience(name, transition.strategy).counts, max(cost, 1e-6) / max(transition.weight, 1e-6)

    def _strategy_name(self, transition: Transition, context: str) -> str:
        named = transition.strategy.name if transition.strategy is not None else ""
        return strategy_name(self._rule.net.name, named or transition.origin, context)

    def context_of(self, strategy: Strategy, told: ActionContext) -> str:
        """Return the context in which a strategy is tried; empty where the net names none, or it has no value."""
        try:
            return as_text(self._rule.values.fill_now(strategy.context, told)) if strategy.context else ""
        except ImError:
            return ""

    def learn(self, index: int, told: ActionContext, failure: ImError | None) -> None:
        """Count the outcome of a strategy.

        Args:
            index: The transition of the strategy that begins its action.
            told: Its context.
            failure: Why it failed; None: it succeeded.

        Raises:
            OSError: The count cannot be saved.
            ImError: Likewise.
        """
        taken = self._transitions[index]
        assert taken.strategy is not None
        context = self.context_of(taken.strategy, told)
        rivals = [self._transitions[rival] for sharing in self._enabling.contended[index] for rival in sharing]
        names = tuple(self._strategy_name(each, context) for each in rivals if each.strategy is not None)
        last = DONE if failure is None else failure.message
        self.book.outcome(StrategyOutcome(self._strategy_name(taken, context), taken.strategy, last, names))

    def _tell(self, top: Sequence[int], winner: int) -> None:
        if len(top) < 2 or not any(self._transitions[i].strategy is not None for i in top):
            return
        distribution = probabilities(self._weights(top))
        others = [self._transitions[i].inputs for i in top if i != winner]
        taken = self._transitions[winner]
        lineage = self._rule.foreseen(winner, self.owner(winner))
        told = self._context(winner, lineage)
        self._rule.notifier.chose(
            StrategyChosen(
                self._rule.net.name,
                tuple(place for place in taken.inputs if any(place in inputs for inputs in others)),
                {self._transitions[i].origin: p for i, p in zip(top, distribution, strict=True)},
                entropy(distribution),
                taken.origin,
                "" if taken.strategy is None else self.context_of(taken.strategy, told),
                lineage.job,
            )
        )

    def _guard_broke(self, index: int, lineage: Lineage, error: BaseException) -> bool:
        """Note the failed guard of a transition; return the guard's assumed value."""
        guard = self._transitions[index].guard
        name = guard.name if guard is not None else ""
        failure = error if isinstance(error, ImError) else NetError(f"guard {name} failed: {error!r}", guard=name)
        if lineage.job is not None:
            happens(self._rule, GuardBroke(lineage.job.number, failure))
        self._rule.notifier.troubled(f"guard {name} counts as false: {failure}")
        return False

    def _context(self, index: int, lineage: Lineage) -> ActionContext:
        """Return the context given to the guard of a transition."""
        rule = self._rule
        name, progress = self._transitions[index].origin, rule.notifier.progressed
        shared, values = rule.shared_objects, rule.values
        return ActionContext(rule.net.name, name, lineage, progress=progress, shared=shared, values=values)


class Delays:
    """Clocks of the enabled transitions with a delay: of each as many as it has servers with tokens.

    Clocks belong to no token. Where tokens leave, the clocks that began last stop.

    Args:
        transitions: The transitions of the expanded net.
        enabling: The marking, and what it enables.
        conflicts: Is told which have waited long enough; has the dice.
        timers: Strike.
        clock: Present time [s].
    """

    def __init__(
        self,
        transitions: Sequence[Transition],
        enabling: Enabling,
        conflicts: ConflictResolution,
        timers: Timers,
        clock: Callable[[], float],
    ) -> None:
        self._transitions, self._enabling, self._conflicts = transitions, enabling, conflicts
        self._timers, self._clock = timers, clock
        self._running: dict[int, list[Timer]] = {}
        self._several = frozenset(i for i in conflicts.delayed if transitions[i].at_once > 1)

    def waits(self, index: int) -> bool:
        """Return whether an enabled transition must still wait; the clock runs while symbol and guard allow firing."""
        ripe, several = index in self._conflicts.ripe, index in self._several
        if index not in self._conflicts.delayed or (ripe and not several):
            return False
        transition = self._transitions[index]
        looked_at = several or transition.guard is not None
        if transition.delay is None or (index in self._running and not looked_at):
            return True
        if not self._conflicts.holds(index):
            self._stop(index)
            return True
        clocks = self._running.setdefault(index, [])
        self._enabling.clocks.add(index)
        while len(clocks) < self._servers(index):
            time = self._clock() + transition.delay.sample(self._conflicts.dice)
            clocks.append(self._timers.at(time, lambda: self._ripen(index)))
        if looked_at and not ripe:
            self._enabling.stalled.add(index)  # what wakes its guard, or changes its tokens, has it looked at again
        return not ripe

    def settle(self, fired: int | None = None) -> None:
        """Stop the clocks of transitions disabled by a firing, and of the fired one."""
        crossed, unmet = self._enabling.crossed, self._enabling.unmet
        for index in crossed:
            if unmet[index]:
                self._stop(index)
        crossed.clear()
        if fired is not None and fired in self._enabling.clocks:
            clocks = self._running[fired]
            clocks.remove(next(clock for clock in clocks if clock.act is None))
        for index in self._enabling.clocks & (self._several | {fired}):
            clocks = self._running[index]
            while len(clocks) > self._servers(index):
                self._timers.cancel(clocks.pop())
            if not clocks:
                self._stop(index)
            elif all(clock.act is not None for clock in clocks):
                self._conflicts.ripe.discard(index)

    def strikes_at(self, index: int) -> float | None:
        """Return the time at which the clock of a transition strikes [s]; None: it does not run."""
        return min((clock.time for clock in self._running.get(index, ()) if clock.act is not None), default=None)

    def give_up(self, index: int) -> None:
        """Restart the wait of a transition blocked by the guard or symbol."""
        if index in self._conflicts.ripe:
            self._stop(index)

    def _servers(self, index: int) -> int:
        """Return how many servers of an enabled transition have tokens."""
        if index not in self._several:
            return 1
        return min(self._transitions[index].at_once, self._enabling.compiled.degree(self._enabling.tokens, index))

    def _stop(self, index: int) -> None:
        for clock in self._running.pop(index, ()):
            self._timers.cancel(clock)
        self._enabling.clocks.discard(index)
        self._conflicts.ripe.discard(index)

    def _ripen(self, index: int) -> None:
        self._conflicts.ripe.add(index)
        self._enabling.consider(index)
