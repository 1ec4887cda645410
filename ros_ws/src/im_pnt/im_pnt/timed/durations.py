"""Expected duration of a command, where its time goes, and its bottleneck.

From the marking where the symbol is read to the one where ``<symbol>_done`` or ``<symbol>_failed`` is emitted. Exact
where means decide (exponential delays, or one thing at a time), by simulation otherwise.

The expected duration is homogeneous of degree one in the mean delays, so that it is the sum over all actions of mean
times derivative (Euler): the part of the duration that hangs on the action. In a run it is the action's time on the
critical path.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from im_pnt.errors import NetError
from im_pnt.net import Net, Role
from im_pnt.timed.command import Totals, exact_totals, play_command
from im_pnt.timed.model import TimedNet, timed_net

_QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True, slots=True)
class ActionTime:
    """What a transition contributes to the duration of a command.

    Attributes:
        transition: Its name, qualified by the net where there are several.
        firings: How often it happens in one command, expected.
        mean: How long it takes each time, expected [s]; of a request until its reply.
        share: Its time over that of the command; shares of what runs at the same time add up to more than 1.
        critical: Part of the command's duration that hangs on it [s]; 0 of a request, whose server has it. They add
            up to the duration.
        sensitivity: Derivative of the command's duration by its mean delay.
    """

    transition: str
    firings: float
    mean: float
    share: float
    critical: float
    sensitivity: float


@dataclass(frozen=True, slots=True)
class CommandDuration:
    """How long a command takes.

    Attributes:
        nets: Names of the nets.
        symbol: The command.
        mean: Expected duration [s].
        half_width: Half the width of its 95 % confidence interval [s]; 0: exact.
        quantiles: Durations that 5, 50 and 95 % of the simulated runs did not exceed [s].
        done: Probability that it ends with ``<symbol>_done``.
        actions: Transitions with an action or a delay, those with the largest critical part first.
        method: How the mean was computed.
        runs: Simulated runs.
        assumptions: What is taken for granted.
    """

    nets: tuple[str, ...]
    symbol: str
    mean: float
    half_width: float
    quantiles: tuple[float, float, float]
    done: float
    actions: tuple[ActionTime, ...]
    method: str
    runs: int
    assumptions: tuple[str, ...]

    @property
    def bottleneck(self) -> ActionTime:
        """The action on which most of the duration hangs."""
        return self.actions[0]


def expected_command(
    nets: Sequence[Net], symbol: str, *, seed: int = 0, runs: int = 1000, failures: float = 0.0
) -> CommandDuration:
    """Computes how long a command takes, from reading its symbol to emitting its answer.

    Args:
        nets: The net that reads the symbol, and those whose services it needs.
        symbol: The command.
        seed: Seed of the simulated runs.
        runs: Number of simulated runs.
        failures: Probability that an action without ``success`` fails.

    Raises:
        NetError: Nobody reads the symbol or answers it, nothing takes time, or it may never be answered.
    """
    if runs < 2:
        raise NetError(f"{runs} runs are too few for a spread; at least 2 are needed")
    model = timed_net(nets, failures=failures, command=symbol)
    exact = exact_totals(model, symbol)
    played = play_command(model, symbol, seed, runs)
    if exact is None:
        totals = played.totals
        spread = math.sqrt(sum((t - totals.duration) ** 2 for t in played.durations) / (runs - 1))
        half_width, method = 1.96 * spread / math.sqrt(runs), f"simulation of {runs} runs"
    else:
        totals, method = exact
        half_width = 0.0
    if totals.duration <= 0.0:
        raise NetError(f"command {symbol} is answered at once: nothing that it does has a delay")
    durations = sorted(played.durations)
    low, median, high = (durations[min(int(q * runs), runs - 1)] for q in _QUANTILES)
    return CommandDuration(
        tuple(net.name for net in nets),
        symbol,
        totals.duration,
        half_width,
        (low, median, high),
        totals.done,
        _actions(model, totals),
        method,
        runs,
        model.assumptions,
    )


def _actions(net: TimedNet, totals: Totals) -> tuple[ActionTime, ...]:
    number = {name: index for index, name in enumerate(net.compiled.transitions)}
    place = {name: index for index, name in enumerate(net.compiled.places)}
    timer_of = {timer.name: index for index, timer in enumerate(net.timers)}
    actions: list[ActionTime] = []

    def add(name: str, firings: float, time: float) -> None:
        if firings > 0.0:
            timer = timer_of.get(name)
            critical = totals.critical[timer] if timer is not None else 0.0
            slope = critical / net.timers[timer].delay.mean if timer is not None else 0.0
            actions.append(ActionTime(name, firings, time / firings, time / totals.duration, critical, slope))

    for transition in net.compiled.net.transitions.values():
        if transition.role is Role.START:
            name = transition.name.removesuffix(".start")
            add(name, totals.firings[number[transition.name]], totals.token_time[place[f"{name}.active"]])
    for timer in net.timers:
        if timer.active is None:
            firings = totals.firings[number[timer.name]]
            add(timer.name, firings, firings * timer.delay.mean)
    return tuple(sorted(actions, key=lambda action: (-action.critical, -action.share)))
