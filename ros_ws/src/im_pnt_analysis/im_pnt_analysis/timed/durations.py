"""A command as a process that ends with its answer: its averages, computed or simulated.

Computed by a renewal process: the answer leads back to the beginning, and one cycle is one command.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from im_pnt.errors import NetError
from im_pnt.timed.chain import Chain, chain, class_measure, recurrent_classes
from im_pnt.timed.markings import Markings, TooManyMarkingsError, reach
from im_pnt.timed.model import TimedNet
from im_pnt.timed.player import Ended, Player

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
    """Simulated runs: their durations [s], and the averages of everything."""

    durations: list[float]
    totals: Totals


def play_command(net: TimedNet, symbol: str, seed: int, runs: int) -> Played:
    """Simulates commands and averages them.

    Args:
        net: Made for one command.
        symbol: The command.
        seed: The same seed gives the same runs.
        runs: Number of runs.

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
        while cause is not None:
            cause, timer, begin, end = cause
            critical[timer] += (end - begin) / runs
    return Played(durations, Totals(sum(durations) / runs, done / runs, firings, token_time, critical))


def exact_totals(net: TimedNet, symbol: str) -> tuple[Totals, str] | None:
    """Computes the averages where means decide, and says how.

    Args:
        net: Made for one command.
        symbol: The command.

    Returns:
        None where means do not decide, or where there are too many markings.

    Raises:
        NetError: Nothing takes time, or the command may never be answered.
    """
    assert net.ends is not None
    try:
        found = reach(net, states=_STATES)
    except TooManyMarkingsError:
        return None
    if found.rivals:
        return None
    if not any(found.tangible):
        raise NetError(f"nothing that command {symbol} does has a delay")
    _require_answer(found, symbol)
    links = chain(found, float)
    classes = recurrent_classes(found)
    measure, method = class_measure(links, classes[0], None)
    done_place = net.ends[0]
    answered = {s: value for s, value in measure.items() if _is_end(found, s)}
    rate = sum(answered.values())
    spent = {state: value / rate for state, value in measure.items()}
    firings, token_time = [0.0] * len(net.shown), [0.0] * len(net.shown_places)
    critical = [0.0] * len(net.timers)
    remaining = _remaining(links)
    timer_of = {outcome: i for i, timer in enumerate(net.timers) for outcome, _ in timer.outcomes}
    for state, time in spent.items():
        if _is_end(found, state):
            continue
        for transition, target, speed in links.firings[state]:
            firings[transition] += time * speed
            if found.tangible[state]:
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
    from im_pnt.timed.sparse import bottom_classes

    for members in bottom_classes(found.arcs):
        if not any(_is_end(found, state) for state in members):
            way = " -> ".join(found.sequence(members[0])) or "(nothing)"
            marking = _text(found.net.marking(found.vectors[members[0]]))
            what = "goes round for ever" if found.arcs[members[0]] else "comes to a stop"
            raise NetError(f"command {symbol} {what} without an answer after {way}, with {marking}")


def _remaining(links: Chain[float]) -> Sequence[float]:
    """Solves for the time that is left in each marking until the answer [s]."""
    from im_pnt.timed.sparse import remaining_time

    found = links.found
    ends = [state for state in range(len(found.vectors)) if _is_end(found, state)]
    return remaining_time(links.rows, found.tangible, ends)


def _text(marking: Mapping[str, int]) -> str:
    return ", ".join(f"{place}={count}" for place, count in marking.items()) or "no tokens"
