"""Experience with strategies: alternatives chosen by a learned probability of success (paper, section 2).

The outcomes of a strategy in a context are counted, and a Beta distribution is what they tell of its probability of
success. Each outcome decays the counts of all strategies that contend: the world changes, and a strategy that was not
tried for long is uncertain again. Discounted Thompson sampling: V. Raj and S. Kalyani, "Taming non-stationary bandits",
2017; the expected cost until a success is cost / probability.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from im_pnt.model.net import Strategy

_CELLS = 96
_MIDDLES = [(cell + 0.5) / _CELLS for cell in range(_CELLS)]
_LOGS = [(math.log(p), math.log1p(-p)) for p in _MIDDLES]


@dataclass(frozen=True, slots=True)
class Experience:
    """Experience with a strategy in a context.

    Attributes:
        successes: Counted successes, decayed.
        failures: Counted failures, decayed.
        prior: Successes and failures counted before the first run, as the net says.
        last: How the last try ended: empty before the first, ``done``, or the reason of the failure.
    """

    successes: float = 0.0
    failures: float = 0.0
    prior: tuple[float, float] = (1.0, 1.0)
    last: str = ""

    @property
    def counts(self) -> tuple[float, float]:
        """Both parameters of the Beta distribution."""
        return self.successes + self.prior[0], self.failures + self.prior[1]

    @property
    def mean(self) -> float:
        """The expected probability of success, 0.5 without any count."""
        successes, failures = self.counts
        return successes / (successes + failures) if successes + failures > 0.0 else 0.5

    def interval(self, mass: float = 0.9) -> tuple[float, float]:
        """Return the central interval of the probability of success, to a hundredth."""
        below, last, ends = 0.0, 0.0, [0.0, 1.0]
        for cell, density in enumerate(beta_cells(*self.counts)):
            last, below = below, below + density
            for number, level in enumerate((0.5 - 0.5 * mass, 0.5 + 0.5 * mass)):
                if last < level <= below:
                    ends[number] = (cell + (level - last) / density) / _CELLS
        return ends[0], ends[1]


class StrategyOutcome(NamedTuple):
    """Outcome of a try.

    Attributes:
        name: Strategy with its context, as of :func:`strategy_name`.
        strategy: As the net says.
        last: ``done``, or the reason of the failure.
        rivals: Strategies that contend in this context.
    """

    name: str
    strategy: Strategy
    last: str
    rivals: tuple[str, ...] = ()


DONE = "done"


def strategy_name(net: str, transition: str, context: str) -> str:
    """Return the name under which experience is kept: ``net.transition`` or ``net.transition@context``."""
    return f"{net}.{transition}@{context}" if context else f"{net}.{transition}"


class StrategyBook:
    """Experience with strategies.

    Attributes:
        learned: Experience with strategies that have had an outcome, by name.
    """

    def __init__(self) -> None:
        self.learned: dict[str, Experience] = {}

    def experience(self, name: str, strategy: Strategy) -> Experience:
        """Return the experience with a strategy so far."""
        return replace(self.learned.get(name, Experience()), prior=(strategy.successes, strategy.failures))

    def outcome(self, outcome: StrategyOutcome) -> None:
        """Count an outcome."""
        name, strategy, last, rivals = outcome
        for each in {name, *rivals} & self.learned.keys():
            kept, decay = self.learned[each], strategy.decay
            self.learned[each] = replace(kept, successes=kept.successes * decay, failures=kept.failures * decay)
        known, good = self.experience(name, strategy), last == DONE
        self.learned[name] = replace(
            known, successes=known.successes + good, failures=known.failures + (not good), last=last[:200]
        )

    def forget(self, start: str) -> list[str]:
        """Forget a strategy in all contexts or in one; return the forgotten names."""
        gone = [name for name in self.learned if start in (name, name.partition("@")[0])]
        for name in gone:
            del self.learned[name]
        return gone


def beta_cells(successes: float, failures: float) -> list[float]:
    """Return the mass of a Beta distribution in equal cells of 0..1; all alike for no counts."""
    logs = [(successes - 1.0) * log + (failures - 1.0) * other for log, other in _LOGS]
    top = max(logs)
    masses = [math.exp(log - top) for log in logs]
    total = math.fsum(masses)
    return [mass / total for mass in masses]


def chances_of_best(alternatives: Sequence[tuple[float, float, float]]) -> list[float]:
    """Return the probability of each alternative that it costs least until it succeeds.

    To draw with them is Thompson sampling; they are computed, so that their entropy is known.

    Args:
        alternatives: Successes, failures, and what one try costs (> 0), of each.
    """
    cells = [beta_cells(successes, failures) for successes, failures, _ in alternatives]
    sums = [_sums(masses) for masses in cells]
    chances = []
    for one, (_, _, cost) in enumerate(alternatives):
        chance = 0.0
        for p, mass in zip(_MIDDLES, cells[one], strict=True):
            for other, (_, _, other_cost) in enumerate(alternatives):
                if other != one:
                    mass *= _below(sums[other], p * other_cost / cost)
            chance += mass
        chances.append(chance)
    total = math.fsum(chances)
    return [chance / total if total > 0.0 else 1.0 / len(chances) for chance in chances]


def _sums(masses: Sequence[float]) -> list[float]:
    total, sums = 0.0, [0.0]
    for mass in masses:
        total += mass
        sums.append(total)
    return sums


def _below(sums: Sequence[float], p: float) -> float:
    """Return the mass below a probability."""
    if p >= 1.0:
        return 1.0
    cell = int(p * _CELLS)
    return sums[cell] + (p * _CELLS - cell) * (sums[cell + 1] - sums[cell])
