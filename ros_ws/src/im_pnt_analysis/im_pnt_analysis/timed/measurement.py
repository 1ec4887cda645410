"""Measured times of transitions: estimates fitted into nets, and comparison with the expectation."""

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from im_pnt.model.action import RequestAction
from im_pnt.model.net import Net, Transition
from im_pnt_analysis.timed.durations import CommandDuration
from im_pnt_analysis.timed.estimation import DelayEstimate, Interval, estimate_delay, estimate_share


@dataclass(frozen=True, slots=True)
class MeasuredFiring:
    """One end of a transition.

    Attributes:
        transition: ``net.transition``, as written in the net.
        duration: Time since it began [s]; 0 of an instantaneous one.
        failed: Whether its action failed.
    """

    transition: str
    duration: float
    failed: bool = False


@dataclass(frozen=True, slots=True)
class TransitionEstimate:
    """Measurement of a transition, and the estimates.

    Attributes:
        count: How often it ended.
        delay: Its time; None: it has no action, or its time is that of another of the nets.
        success: Share of actions that did not fail, with its interval; None likewise.
        weight: Its weight among its rivals; None: it has none, or none of them was seen.
        share: Its share of what it and its rivals did, with its interval; None likewise.
    """

    count: int
    delay: DelayEstimate | None = None
    success: tuple[float, Interval] | None = None
    weight: float | None = None
    share: tuple[float, Interval] | None = None


def estimate(nets: Sequence[Net], seen: Iterable[MeasuredFiring]) -> dict[str, dict[str, TransitionEstimate]]:
    """Estimate times and frequencies of transitions, by net and name, if seen or with seen rivals.

    Transitions that share an input place get their counts as weights, so that guards are true as often as they were.
    Where one of them was not seen, it keeps its weight, and the others divide theirs by their counts: what is rare and
    did not happen remains as probable as written; so do failures. A request to one of the nets has no delay: its time
    is that net's.
    """
    ended: defaultdict[str, list[float]] = defaultdict(list)
    failed: defaultdict[str, int] = defaultdict(int)
    for firing in seen:
        ended[firing.transition].append(firing.duration)
        failed[firing.transition] += firing.failed
    served = {net.name for net in nets}
    return {net.name: _estimate_net(net, ended, failed, served) for net in nets}


def _estimate_net(
    net: Net, ended: Mapping[str, list[float]], failed: Mapping[str, int], served: Collection[str]
) -> dict[str, TransitionEstimate]:
    found: dict[str, TransitionEstimate] = {}
    for name, transition in net.transitions.items():
        times = ended.get(f"{net.name}.{name}", [])
        estimated = TransitionEstimate(len(times))
        mine = not (isinstance(transition.action, RequestAction) and transition.action.net in served)
        if times and transition.action is not None and mine:
            good = len(times) - failed[f"{net.name}.{name}"]
            span = estimate_share(good, len(times))
            as_written = good in (0, len(times)) and span.low <= transition.success <= span.high
            success = transition.success if as_written else good / len(times), span
            estimated = replace(estimated, delay=estimate_delay(times), success=success)
        found[name] = estimated
    for rivals in _rivals(net):
        counts = {name: found[name].count for name in rivals}
        total = sum(counts.values())
        if not total:
            continue
        written = sum(net.transitions[name].weight for name in rivals if counts[name])
        scale = 1.0 if all(counts.values()) else written / total
        for name, count in counts.items():
            share = count / total, estimate_share(count, total)
            weight = scale * count if count else net.transitions[name].weight
            found[name] = replace(found[name], weight=weight, share=share)
    return {name: each for name, each in found.items() if each.count or each.weight is not None}


def _rivals(net: Net) -> Iterable[list[str]]:
    """Return groups of contending transitions, each with all the direct and indirect rivals."""
    left = dict(net.transitions)
    while left:
        group = [left.pop(next(iter(left)))]
        for member in group:
            near = [name for name, other in left.items() if _contend(member, other)]
            group += [left.pop(name) for name in near]
        if len(group) > 1:
            yield [transition.name for transition in group]


def _contend(one: Transition, other: Transition) -> bool:
    return not one.inputs.keys().isdisjoint(other.inputs) and one.priority == other.priority


def with_estimates(net: Net, found: Mapping[str, TransitionEstimate]) -> Net:
    """Return a net with the estimates of the transitions."""
    transitions = dict(net.transitions)
    for name, each in found.items():
        fitted = transitions[name]
        if each.delay is not None and each.success is not None:
            fitted = replace(fitted, delay=each.delay.delay, success=each.success[0])
        elif each.count and isinstance(fitted.action, RequestAction):
            fitted = replace(fitted, delay=None)
        if each.weight is not None:
            fitted = replace(fitted, weight=each.weight, strategy=None)
        transitions[name] = fitted
    return replace(net, transitions=transitions)


@dataclass(frozen=True, slots=True)
class ActionComparison:
    """An action as expected and as measured; means [s]."""

    transition: str
    expected_firings: float
    measured_firings: int
    expected_mean: float
    measured_mean: float | None


def compare(expected: CommandDuration, measured: Mapping[str, Sequence[float]]) -> tuple[ActionComparison, ...]:
    """Compare a measured run of a command with the expected one; the largest expected time comes first.

    Args:
        expected: What was computed.
        measured: Durations of each transition by ``net.transition`` [s].

    >>> compare(expected_command([oven], "bake"), {"oven.bake": [4.5]})[0].measured_mean
    4.5
    """
    rows: list[ActionComparison] = []
    left = dict(measured)
    for action in expected.actions:
        name = action.transition if len(expected.nets) > 1 else f"{expected.nets[0]}.{action.transition}"
        times = left.pop(name, ())
        mean = math.fsum(times) / len(times) if times else None
        rows.append(ActionComparison(name, action.firings, len(times), action.mean, mean))
    for name, times in left.items():
        if any(times):
            rows.append(ActionComparison(name, 0.0, len(times), 0.0, math.fsum(times) / len(times)))
    return tuple(sorted(rows, key=lambda row: -row.expected_firings * row.expected_mean))
