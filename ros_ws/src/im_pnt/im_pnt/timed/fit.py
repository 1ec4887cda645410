"""Nets with the delays, successes and weights of a measured run, so that the model can be compared with it."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from im_pnt.action import RequestAction
from im_pnt.delay import Delay
from im_pnt.net import Net, Transition
from im_pnt.timed.measured import Observation

_CONSTANT = 0.01
"""Coefficient of variation below which times are taken for constant."""


def fit_delays(nets: Sequence[Net], seen: Iterable[Observation]) -> tuple[Net, ...]:
    """Gives the transitions the delays and frequencies that were measured.

    A delay becomes a gamma distribution of the mean and the variance measured, a constant where there is next to no
    variance; ``success`` the share of actions that did not fail. Transitions that share an input place get their counts
    as weights, so that guards are true as often as they were; strategies, whose outcome the counts hold, are dropped.
    What was not measured stays as it is. Requests to a net that is among them keep no delay: their time is its time.

    Args:
        nets: The nets, as written.
        seen: What was measured.
    """
    ended: dict[str, list[float]] = {}
    failed: dict[str, int] = {}
    for observation in seen:
        ended.setdefault(observation.transition, []).append(observation.duration)
        failed[observation.transition] = failed.get(observation.transition, 0) + observation.failed
    given = {net.name for net in nets}
    return tuple(_fit(net, ended, failed, given) for net in nets)


def _fit(net: Net, ended: dict[str, list[float]], failed: dict[str, int], given: set[str]) -> Net:
    counts = {name: len(ended.get(f"{net.name}.{name}", ())) for name in net.transitions}
    transitions: dict[str, Transition] = {}
    for name, transition in net.transitions.items():
        times = ended.get(f"{net.name}.{name}")
        fitted = transition
        if times and transition.action is not None:
            served = isinstance(transition.action, RequestAction) and transition.action.net in given
            delay, success = None if served else _delay(times), 1.0 - failed[f"{net.name}.{name}"] / len(times)
            fitted = replace(transition, delay=delay, success=transition.success if served else success)
        rivals = [other for other in net.transitions.values() if _contend(transition, other)]
        if len(rivals) > 1 and any(counts[rival.name] for rival in rivals):
            fitted = replace(fitted, weight=float(counts[name]), strategy=None)
        transitions[name] = fitted
    return replace(net, transitions=transitions)


def _contend(one: Transition, other: Transition) -> bool:
    return not one.inputs.keys().isdisjoint(other.inputs) and one.priority == other.priority


def _delay(times: Sequence[float]) -> Delay | None:
    mean = math.fsum(times) / len(times)
    if mean <= 0.0:
        return None
    variance = math.fsum((time - mean) ** 2 for time in times) / max(len(times) - 1, 1)
    if variance <= (_CONSTANT * mean) ** 2:
        return Delay("constant", (mean,))
    return Delay("gamma", (mean * mean / variance, variance / mean))
