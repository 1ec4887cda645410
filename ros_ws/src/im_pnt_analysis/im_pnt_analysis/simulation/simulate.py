"""Simulation of nets by structure, delays and probabilities alone: on a virtual clock, with imagined actions.

Long averages come with confidence intervals by batch means (Law, Simulation Modeling, chapter 9).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from im_pnt.errors import NetError
from im_pnt.model.net import Net
from im_pnt_analysis.timed.model import timed_net
from im_pnt_analysis.timed.player import Player


@dataclass(frozen=True, slots=True)
class SimulatedFiring:
    """One firing of a simulation.

    Attributes:
        time: Virtual time [s].
        transition: What fired, by its name in the composition.
        marking: The marked places afterwards.
    """

    time: float
    transition: str
    marking: dict[str, int]


def simulate(
    nets: Sequence[Net], *, seed: int = 0, steps: int | None = 100, until: float | None = None, failures: float = 0.0
) -> Iterator[SimulatedFiring]:
    """Play nets composed with the environment: symbols and callers come to idle nets.

    Args:
        nets: The nets.
        seed: The same seed gives the same run.
        steps: Firings at most; None: no limit.
        until: Virtual time to stop at [s]; None: no limit.
        failures: Probability that an action without ``success`` fails.

    Yields:
        Each firing; ends early where nothing can fire.

    Raises:
        NetError: The nets do not fit together, or no time passes any more.

    >>> [(firing.time, firing.transition) for firing in simulate([oven], steps=4)]
    [(0.0, 'load'), (4.0, 'bake'), (5.0, 'empty'), (5.0, 'load')]
    """
    player = Player(timed_net(nets, failures=failures), seed)
    player.until = run_limits(steps, until)
    net = player.net
    count = 0
    while (steps is None or count < steps) and (fired := player.step()) >= 0:
        count += 1
        yield SimulatedFiring(player.time, net.shown[fired], net.marking(player.tokens))


def run_limits(steps: int | None, until: float | None) -> float:
    """Check the limits of a run, and return the end [s].

    Raises:
        NetError: That is no number of firings, or no time.
    """
    if steps is not None and steps < 1:
        raise NetError(f"{steps} firings cannot be played; at least 1 is needed")
    if until is None:
        return math.inf
    if not 0.0 < until < math.inf:
        raise NetError(f"a run cannot end at time {until}; a number > 0 is needed [s]")
    return until


_BATCHES = 32
_STUDENT_95 = 2.040
"""97.5 % quantile of Student's distribution for 31 degrees of freedom."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Mean with the confidence interval.

    Attributes:
        mean: Estimate.
        half_width: Half the width of its 95 % confidence interval; None where the run was too short to say.
    """

    mean: float
    half_width: float | None


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary of a simulation.

    Attributes:
        time: Virtual time that was simulated [s].
        firings: Firings in all.
        counts: Firings of each transition.
        throughput: Firings a second [1/s]; empty where no time passed.
        mean_tokens: Mean tokens of each place; empty where no time passed.
        stuck: Whether it ended because nothing could fire.
        marking: The marked places at the end.
        assumptions: What is taken for granted.
    """

    time: float
    firings: int
    counts: Mapping[str, int]
    throughput: Mapping[str, Estimate]
    mean_tokens: Mapping[str, Estimate]
    stuck: bool
    marking: Mapping[str, int]
    assumptions: tuple[str, ...]


@dataclass(slots=True)
class _Batch:
    time: float
    counts: list[int]
    areas: list[float]


def summarise(
    nets: Sequence[Net],
    *,
    seed: int = 0,
    steps: int | None = None,
    until: float | None = None,
    failures: float = 0.0,
    progress: Callable[[str], None] = lambda text: None,
) -> Summary:
    """Play nets and average; the first of 33 batches is left out of the averages, as a warm-up.

    Args:
        nets: The nets.
        seed: The same seed gives the same run.
        steps: Firings at most; None: no limit.
        until: Virtual time to stop at [s]; None: no limit.
        failures: Probability that an action without ``success`` fails.
        progress: Is told now and then how far it is.

    Raises:
        NetError: The nets do not fit together, no time passes any more, or there is no limit at all.

    >>> round(summarise([oven], until=1000.0).throughput["bake"].mean, 2)
    0.2
    """
    if steps is None and until is None:
        raise NetError("a simulation needs a number of firings or a time to end at")
    net = timed_net(nets, failures=failures)
    player = Player(net, seed)
    limit = run_limits(steps, until)
    marks = [_Batch(0.0, list(player.firings), player.token_time())]
    left = math.inf if steps is None else steps
    stuck = False
    for batch in range(1, _BATCHES + 2):
        player.until = limit * batch / (_BATCHES + 1) if until is not None else math.inf
        quota = left if until is not None else (steps or 0) * batch // (_BATCHES + 1) - sum(player.firings)
        while quota > 0 and player.step() >= 0:
            quota -= 1
            left -= 1
        marks.append(_Batch(player.time, list(player.firings), player.token_time()))
        progress(f"{sum(player.firings)} firings, {100 * batch // (_BATCHES + 1)} %")
        stuck = left > 0 and player.time < player.until and quota > 0
        if stuck or left <= 0:
            break
    counts: dict[str, int] = {}
    for name, count in zip(net.shown, player.firings, strict=True):
        counts[name] = counts.get(name, 0) + count
    whole = len(marks) == _BATCHES + 2  # else it ended early, and has no warm-up to leave out
    batches = [_between(a, b) for a, b in pairwise(marks)]
    batches = batches[1:] if whole else batches
    return Summary(
        player.time,
        sum(player.firings),
        counts,
        _estimates(net.shown, batches, [batch.counts for batch in batches], whole),
        _estimates(net.shown_places, batches, [batch.areas for batch in batches], whole),
        stuck,
        net.marking(player.tokens),
        net.assumptions,
    )


def _between(begin: _Batch, end: _Batch) -> _Batch:
    return _Batch(
        end.time - begin.time,
        [after - before for before, after in zip(begin.counts, end.counts, strict=True)],
        [after - before for before, after in zip(begin.areas, end.areas, strict=True)],
    )


def _estimates(
    names: Sequence[str], batches: Sequence[_Batch], amounts: Sequence[Sequence[float]], whole: bool
) -> dict[str, Estimate]:
    """Return ratio estimates: amounts of the batches over the times; parts of one name are added."""
    total = sum(batch.time for batch in batches)
    if total <= 0.0:
        return {}
    columns: dict[str, list[float]] = {}
    for number, name in enumerate(names):
        column = [amount[number] for amount in amounts]
        known = columns.get(name)
        columns[name] = column if known is None else [a + b for a, b in zip(known, column, strict=True)]
    estimates = {}
    for name, column in columns.items():
        mean = sum(column) / total
        half_width = None
        if whole:
            squares = sum((amount - mean * batch.time) ** 2 for amount, batch in zip(column, batches, strict=True))
            half_width = _STUDENT_95 * math.sqrt(squares / (_BATCHES - 1) * _BATCHES) / total
        estimates[name] = Estimate(mean, half_width)
    return estimates
