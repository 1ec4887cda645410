"""Measured times of transitions and commands: told by nets or read from a file, fitted into nets, and compared."""

import math
from collections import defaultdict, deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from im_core.errors import ImError
from im_core.files import MEBIBYTE, FileError, read_text
from im_core.jsontext import MAX_VALUES, JsonError, decode_json
from im_pnt.execution.notification import Firing, Phase
from im_pnt.model.action import RequestAction
from im_pnt.model.net import Net, Transition
from im_pnt_analysis.timed.durations import CommandDuration
from im_pnt_analysis.timed.estimation import DelayEstimate, Interval, estimate_delay, estimate_share

_LARGEST = 200 * MEBIBYTE


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
class Measurement:
    """Measured times of nets.

    Attributes:
        firings: Ends of transitions.
        commands: Durations of each command from its symbol to its answer [s], where there are stamps.
    """

    firings: tuple[MeasuredFiring, ...]
    commands: Mapping[str, tuple[float, ...]]

    def by_transition(self) -> dict[str, list[float]]:
        """Return the durations of each transition [s]."""
        durations: defaultdict[str, list[float]] = defaultdict(list)
        for firing in self.firings:
            durations[firing.transition].append(firing.duration)
        return dict(durations)


def measured_firings(firings: Iterable[Firing]) -> list[MeasuredFiring]:
    """Return ends and failures among the events of nets, with the wall time."""
    return [
        MeasuredFiring(f"{firing.net}.{firing.transition}", firing.duration, firing.phase == Phase.FAILED)
        for firing in firings
        if firing.phase in (Phase.END, Phase.FAILED)
    ]


def read_measurement(file: str, nets: Sequence[Net] = ()) -> Measurement:
    """Read measured times.

    The file holds one JSON object ``{"net.transition": [seconds, ...]}``, or firings as on ``/pnt/firings``, in a list
    or one a line: ``{"net": ..., "transition": ..., "phase": 0|1|2, "duration": seconds}``. Where all of them have a
    ``stamp`` (seconds, or sec and nanosec), times are differences of stamps: testbed time, not wall time.

    Args:
        file: Its path.
        nets: Those that fired, as far as they are known: a firing names one symbol only, and its net all that it emits.

    Raises:
        ImError: There is no such file, or it holds something else.
    """
    try:
        text = read_text(file, _LARGEST)
    except FileError as error:
        raise _bad(file, error.sentence) from error
    try:
        data = decode_json(text)
    except JsonError:
        data = _lines(file, text)
    if isinstance(data, dict) and "transition" in data:
        data = [data]
    if isinstance(data, dict):
        found = tuple(MeasuredFiring(name, time) for name, times in data.items() for time in _times(file, name, times))
        return Measurement(found, {})
    if not isinstance(data, list):
        raise _bad(file, "a JSON list or object is needed")
    if not data:
        raise _bad(file, "the file has no firings")
    return _from_records(file, data, nets)


def _lines(file: str, text: str) -> list[object]:
    """Read a file with a JSON value a line."""
    data, values = list[object](), 0
    for number, line in enumerate(text.splitlines(), start=1):
        values += line.count(",")
        if values > MAX_VALUES:
            raise _bad(file, f"the file has more than {MAX_VALUES} values, the most allowed")
        if line.strip():
            try:
                data.append(decode_json(line))
            except JsonError as error:
                raise _bad(file, f"line {number}: {error.sentence}") from error
    return data


def _bad(file: str, why: str) -> ImError:
    return ImError(f"cannot read measured times from '{file}': {why}", code="input", file=file)


def _times(file: str, name: str, times: object) -> list[float]:
    values = [_time(time) for time in times] if isinstance(times, list) else [None]
    if None in values:
        raise _bad(file, f"'{name}' must be a list of times >= 0 [s]")
    return [value for value in values if value is not None]


def _time(value: object) -> float | None:
    """Return a time [s], also of a stamp in sec and nanosec; None for anything else."""
    if isinstance(value, dict):
        sec, nanosec = _time(value.get("sec")), _time(value.get("nanosec"))
        return None if sec is None or nanosec is None else sec + nanosec * 1e-9
    if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < 1e300:
        return float(value)
    return None


def _from_records(file: str, records: list[object], nets: Sequence[Net]) -> Measurement:
    emitted = {f"{net.name}.{name}": transition.emit for net in nets for name, transition in net.transitions.items()}
    stamped = all(isinstance(record, dict) and "stamp" in record for record in records)
    begun: defaultdict[str, deque[float]] = defaultdict(deque)
    commands: defaultdict[str, list[float]] = defaultdict(list)
    found: list[MeasuredFiring] = []
    for number, record in enumerate(records, start=1):
        if not isinstance(record, dict):
            raise _bad(file, f"entry {number} is not an object")
        net, transition, phase = record.get("net"), record.get("transition"), record.get("phase")
        if not isinstance(net, str) or not isinstance(transition, str) or type(phase) is not int:
            raise _bad(file, f"entry {number} needs net, transition (names) and phase (0 start, 1 end, 2 failed)")
        name = f"{net}.{transition}"
        given = record["stamp"] if stamped else record.get("duration", 0.0)
        time = _time(given)
        if time is None:
            raise _bad(file, f"entry {number} has the time {given!r}; a number >= 0 is needed [s]")
        if phase == Phase.START:
            begun[name].append(time)
        elif phase in (Phase.END, Phase.FAILED):
            since = begun[name].popleft() if begun[name] else time
            found.append(MeasuredFiring(name, max(time - since, 0.0) if stamped else time, phase == Phase.FAILED))
        said = [record.get("symbol"), *(emitted.get(name, ()) if phase == Phase.END else ())]
        for symbol in dict.fromkeys(each for each in said if stamped and isinstance(each, str) and each):
            command = symbol.removesuffix("_done").removesuffix("_failed")
            key = f"{net} {command}"
            if command == symbol:
                begun[key].append(time)
            elif begun[key]:
                commands[command].append(max(time - begun[key].popleft(), 0.0))
    return Measurement(tuple(found), {command: tuple(times) for command, times in commands.items()})


@dataclass(frozen=True, slots=True)
class TransitionEstimate:
    """Measurement of a transition, and the estimates.

    Attributes:
        count: How often it ended.
        delay: Its time; None: it has no action, or its time is that of a net among those that are known.
        success: Share of actions that did not fail, with its interval; None likewise.
        weight: Its weight among its rivals; None: it has none, or none of them was seen.
        share: Its share of what it and its rivals did, with its interval; None likewise.
    """

    count: int
    delay: DelayEstimate | None = None
    success: tuple[float, Interval] | None = None
    weight: float | None = None
    share: tuple[float, Interval] | None = None


def estimate(
    nets: Sequence[Net], seen: Iterable[MeasuredFiring], known: Collection[str] = ()
) -> dict[str, dict[str, TransitionEstimate]]:
    """Estimate times and frequencies of transitions, by net and name, if seen or with seen rivals.

    Transitions that share an input place get their counts as weights, so that guards are true as often as they were.
    Where one of them was not seen, it keeps its weight, and the others divide theirs by their counts: what is rare and
    did not happen remains as probable as written; so do failures. A request to a known net has no delay: its time is
    that net's.

    Args:
        nets: The nets, as written.
        seen: What was measured.
        known: Further nets that say themselves how long they take.
    """
    ended: defaultdict[str, list[float]] = defaultdict(list)
    failed: defaultdict[str, int] = defaultdict(int)
    for firing in seen:
        ended[firing.transition].append(firing.duration)
        failed[firing.transition] += firing.failed
    served = {*known, *(net.name for net in nets)}
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


def fit_delays(nets: Sequence[Net], seen: Iterable[MeasuredFiring]) -> tuple[Net, ...]:
    """Give the transitions the delays and frequencies of :func:`estimate`.

    Strategies, whose outcome the counts hold, are dropped. What was not measured stays as it is.

    Args:
        nets: The nets, as written.
        seen: What was measured.
    """
    found = estimate(nets, seen)
    return tuple(with_estimates(net, found[net.name]) for net in nets)


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
    """Compare the measured run of a command with the expected one.

    Args:
        expected: What was computed.
        measured: Durations of each transition by ``net.transition`` [s].
        duration: Measured duration of the command [s].

    >>> compare(expected_command([oven], "bake"), {"oven.bake": [4.5]}, duration=5.5).plausible
    False
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
