"""Expected duration of a command, the shares of the actions, and the bottleneck.

From the marking where the symbol is read to the one where ``<symbol>_done`` or ``<symbol>_failed`` is emitted. Exact
where means decide (exponential delays, or one thing at a time), by simulation otherwise.

The expected duration is homogeneous of degree one in the mean delays, so that it is the sum over all actions of mean
times derivative (Euler): the part of the duration that hangs on the action. In a run it is the action's time on the
critical path.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from im_pnt.errors import NetError
from im_pnt.model.net import Net, Role
from im_pnt_analysis.timed.chain import (
    Chain,
    Markings,
    TooManyMarkingsError,
    chain,
    class_measure,
    reach,
    recurrent_classes,
)
from im_pnt_analysis.timed.model import TimedNet, timed_net
from im_pnt_analysis.timed.player import Ended, Player

_STATES = 50_000
_FIRINGS = 200_000


@dataclass(slots=True)
class Totals:
    """Expected amounts of one command.

    Attributes:
        duration: From its symbol to its answer [s].
        done: Probability that the answer is ``<symbol>_done``.
        firings: Of each transition.
        token_time: Tokens of each place, integrated over the time [s].
        critical: For each timer the part of the duration that hangs on it [s].
    """

    duration: float
    done: float
    firings: list[float]
    token_time: list[float]
    critical: list[float]


@dataclass(slots=True)
class Played:
    """Simulated runs: the durations [s], and the averages of everything."""

    durations: list[float]
    totals: Totals


def play_command(net: TimedNet, symbol: str, seed: int, runs: int, progress: Callable[[str], None]) -> Played:
    """Simulate commands and average the results.

    Args:
        net: Made for one command.
        symbol: The command.
        seed: The same seed gives the same runs.
        runs: Number of runs.
        progress: Is told how far it is.

    Raises:
        NetError: A run ends without an answer.
    """
    assert net.ends is not None
    done_place, failed_place = net.ends
    player = Player(net, seed, causes=True)
    firings, token_time = [0.0] * len(net.shown), [0.0] * len(net.shown_places)
    critical = [0.0] * len(net.timers)
    durations: list[float] = []
    done = 0
    for run in range(runs):
        if run:
            player.reset()
            progress(f"{run} of {runs} runs")
        count = 0
        while not player.tokens[done_place] and not player.tokens[failed_place]:
            count += 1
            if player.step() < 0 or count > _FIRINGS:
                marking = net.marking(player.tokens)
                what = f"after {_FIRINGS} firings has no answer" if count > _FIRINGS else "comes to a stop"
                raise NetError(f"command {symbol} {what} in simulated run {run + 1}, with {_text(marking)}")
        done += bool(player.tokens[done_place])
        durations.append(player.time)
        for index, number in enumerate(player.firings):
            firings[index] += number / runs
        for index, time in enumerate(player.token_time()):
            token_time[index] += time / runs
        cause: Ended | None = player.last
        while cause is not None:  # from the answer back to the symbol: each link waited for the one before it
            cause, timer, begin, end = cause
            critical[timer] += (end - begin) / runs
    return Played(durations, Totals(sum(durations) / runs, done / runs, firings, token_time, critical))


def exact_totals(net: TimedNet, symbol: str) -> tuple[Totals, str] | None:
    """Compute the averages where means decide, and name the method.

    Returns:
        None where means do not decide, or where there are too many markings.

    Raises:
        NetError: Nothing takes time, or the command may never be answered.
    """
    assert net.ends is not None
    try:
        found = reach(net, states=_STATES, stop_at_rivals=True)
    except TooManyMarkingsError:
        return None
    if found.rivals:
        return None
    if not any(found.tangible):
        raise NetError(f"command {symbol} fires no transition with a delay; its duration needs one")
    _require_answer(found, symbol)
    links = chain(found)
    classes = recurrent_classes(found)
    measure, method = class_measure(links, classes[0])
    done_place = net.ends[0]
    answered = {s: value for s, value in measure.items() if _is_end(found, s)}
    rate = sum(answered.values())  # answers a second, each begins the next command: one takes 1 / rate
    spent = {state: value / rate for state, value in measure.items()}
    firings, token_time = [0.0] * len(net.shown), [0.0] * len(net.shown_places)
    critical = [0.0] * len(net.timers)
    remaining = _remaining(links)
    timer_of = {way: i for i, timer in enumerate(net.timers) for ways, _ in timer.outcomes for way in ways}
    for state, time in spent.items():
        if _is_end(found, state):
            continue
        for transition, target, speed in links.firings[state]:
            firings[transition] += time * speed
            if found.tangible[state]:
                # the remaining time that a firing takes away is its part of the critical path
                critical[timer_of[transition]] += time * speed * (remaining[state] - remaining[target])
        if found.tangible[state]:
            for place, count in enumerate(found.vectors[state]):
                token_time[place] += time * count
    done = sum(value for state, value in answered.items() if found.vectors[state][done_place]) / rate
    alone = "" if all(timer.delay.kind == "exponential" for timer in net.timers) else ", one thing at a time"
    return Totals(1.0 / rate, done, firings, token_time, critical), f"exact ({method}{alone})"


def _is_end(found: Markings, state: int) -> bool:
    assert found.net.ends is not None
    return any(found.vectors[state][place] for place in found.net.ends)


def _require_answer(found: Markings, symbol: str) -> None:
    from im_pnt_analysis.timed.sparse import bottom_classes

    for members in bottom_classes(found.arcs):
        if not any(_is_end(found, state) for state in members):
            way = " -> ".join(found.sequence(members[0])) or "(nothing)"
            marking = _text(found.net.marking(found.vectors[members[0]]))
            what = "goes round for ever" if found.arcs[members[0]] else "comes to a stop"
            raise NetError(f"command {symbol} {what} without an answer after {way}, with {marking}")


def _remaining(links: Chain) -> Sequence[float]:
    """Solve for the remaining time of each marking until the answer [s]."""
    from im_pnt_analysis.timed.sparse import remaining_time

    found = links.found
    ends = [state for state in range(len(found.vectors)) if _is_end(found, state)]
    return remaining_time(links.rows, found.tangible, ends)


def _text(marking: Mapping[str, int]) -> str:
    return ", ".join(f"{place}={count}" for place, count in marking.items()) or "no tokens"


_QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True, slots=True)
class ActionTime:
    """Contribution of a transition to the duration of a command.

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
    nets: Sequence[Net],
    symbol: str,
    *,
    seed: int = 0,
    runs: int = 1000,
    progress: Callable[[str], None] = lambda text: None,
) -> CommandDuration:
    """Compute the duration of a command, from the symbol to the answer.

    Args:
        nets: The net that reads the symbol, and those whose services it needs.
        symbol: The command.
        seed: Seed of the simulated runs.
        runs: Number of simulated runs.
        progress: Is told now and then how far it is.

    Raises:
        NetError: Nobody reads the symbol or answers it, nothing takes time, or it may never be answered.

    >>> expected = expected_command([oven], "bake")
    >>> expected.mean, expected.half_width, expected.bottleneck.transition
    (5.0, 0.0, 'bake')
    """
    if runs < 2:
        raise NetError(f"{runs} runs are too few for a spread; at least 2 are needed")
    model = timed_net(nets, command=symbol)
    exact = exact_totals(model, symbol)
    played = play_command(model, symbol, seed, runs, progress)
    if exact is None:
        totals = played.totals
        spread = math.sqrt(sum((t - totals.duration) ** 2 for t in played.durations) / (runs - 1))
        half_width, method = 1.96 * spread / math.sqrt(runs), f"simulation of {runs} runs"
    else:
        totals, method = exact
        half_width = 0.0
    if totals.duration <= 0.0:
        raise NetError(f"command {symbol} is answered at once: it fires no transition with a delay")
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

    begun: dict[str, float] = {}
    for transition in net.compiled.net.transitions.values():
        if transition.role is Role.START:  # of a command of another net there is one for each who asks for it
            active = next(output for output in transition.outputs if output.endswith(".active"))
            begun[active] = begun.get(active, 0.0) + totals.firings[number[transition.name]]
    for active, firings in begun.items():
        add(active.removesuffix(".active"), firings, totals.token_time[place[active]])
    for timer in net.timers:
        if timer.active is None:
            firings = totals.firings[number[timer.name]]
            add(timer.name, firings, firings * timer.delay.mean)
    return tuple(sorted(actions, key=lambda action: (-action.critical, -action.share)))
