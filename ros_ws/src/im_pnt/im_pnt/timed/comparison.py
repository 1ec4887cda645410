"""A command as expected beside the same command as measured."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from im_pnt.timed.durations import CommandDuration


@dataclass(frozen=True, slots=True)
class ActionComparison:
    """An action as expected and as measured; means [s]."""

    transition: str
    expected_firings: float
    measured_firings: int
    expected_mean: float
    measured_mean: float | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """A command as expected and as measured.

    Attributes:
        symbol: The command.
        expected: Expected duration [s].
        measured: Measured duration [s]; None: not measured.
        plausible: Whether the measured one lies between the expected 5 % and 95 % quantiles; None: not measured.
        bottleneck: The action on which most of the expected duration hangs.
        actions: Actions that were expected or measured, the largest expected time first.
    """

    symbol: str
    expected: float
    measured: float | None
    plausible: bool | None
    bottleneck: str
    actions: tuple[ActionComparison, ...]


def compare(
    expected: CommandDuration, measured: Mapping[str, Sequence[float]], duration: float | None = None
) -> Comparison:
    """Puts the measured run of a command beside the expected one.

    Args:
        expected: What was computed.
        measured: Durations of each transition by ``net.transition`` [s].
        duration: Measured duration of the command [s].
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
    rows.sort(key=lambda row: -row.expected_firings * row.expected_mean)
    low, _, high = expected.quantiles
    plausible = None if duration is None else low <= duration <= high
    bottleneck = expected.bottleneck.transition
    return Comparison(expected.symbol, expected.mean, duration, plausible, bottleneck, tuple(rows))
