"""Measured times of transitions and commands, as nets tell them or as a file holds them."""

import json
from collections import defaultdict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from im_core.errors import ImError
from im_pnt.events import Firing, Phase

_LARGEST = 200_000_000


@dataclass(frozen=True, slots=True)
class Observation:
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
    """What was measured.

    Attributes:
        observations: Ends of transitions.
        commands: Durations of each command from its symbol to its answer [s], where there are stamps.
    """

    observations: tuple[Observation, ...]
    commands: Mapping[str, tuple[float, ...]]

    def by_transition(self) -> dict[str, list[float]]:
        """Returns the durations of each transition [s]."""
        durations: defaultdict[str, list[float]] = defaultdict(list)
        for observation in self.observations:
            durations[observation.transition].append(observation.duration)
        return dict(durations)


def observations(firings: Iterable[Firing]) -> list[Observation]:
    """Picks the ends and failures out of what nets told, with their wall time."""
    return [
        Observation(f"{firing.net}.{firing.transition}", firing.duration, firing.phase == Phase.FAILED)
        for firing in firings
        if firing.phase in (Phase.END, Phase.FAILED)
    ]


def read_measurement(file: str) -> Measurement:
    """Reads measured times.

    The file holds one JSON object ``{"net.transition": [seconds, ...]}``, or firings as on ``/pnt/firings``, in a list
    or one a line: ``{"net": ..., "transition": ..., "phase": 0|1|2, "duration": seconds}``. Where all of them have a
    ``stamp`` (seconds, or sec and nanosec), times are differences of stamps: testbed time, not wall time.

    Raises:
        ImError: There is no such file, or it holds something else.
    """
    path = Path(file)
    try:
        if path.stat().st_size > _LARGEST:
            raise _bad(file, f"it is larger than {_LARGEST // 1_000_000} MB")
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        why = str(error.strerror) if isinstance(error, OSError) else "it is not text in UTF-8"
        raise _bad(file, why) from error
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        data = []
        for number, line in enumerate(text.splitlines(), start=1):
            if line.strip():
                try:
                    data.append(json.loads(line))
                except (ValueError, RecursionError) as error:
                    raise _bad(file, f"line {number} is not JSON: {error}") from error
    if isinstance(data, dict) and "transition" in data:
        data = [data]
    if isinstance(data, dict):
        found = tuple(Observation(name, time) for name, times in data.items() for time in _times(file, name, times))
        return Measurement(found, {})
    if not isinstance(data, list):
        raise _bad(file, "it holds neither a list nor an object")
    if not data:
        raise _bad(file, "it holds no firings")
    return _from_records(file, data)


def _bad(file: str, why: str) -> ImError:
    return ImError(f"cannot read measured times from '{file}': {why}", code="input", file=file)


def _times(file: str, name: str, times: object) -> list[float]:
    values = [_time(time) for time in times] if isinstance(times, list) else [None]
    if None in values:
        raise _bad(file, f"'{name}' must be a list of times >= 0 [s]")
    return [value for value in values if value is not None]


def _time(value: object) -> float | None:
    """Returns a time [s], also of a stamp in sec and nanosec; None if it is none."""
    if isinstance(value, dict):
        sec, nanosec = _time(value.get("sec")), _time(value.get("nanosec"))
        return None if sec is None or nanosec is None else sec + nanosec * 1e-9
    if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < 1e300:
        return float(value)
    return None


def _from_records(file: str, records: list[object]) -> Measurement:
    stamped = all(isinstance(record, dict) and "stamp" in record for record in records)
    begun: defaultdict[str, deque[float]] = defaultdict(deque)
    commands: defaultdict[str, list[float]] = defaultdict(list)
    found: list[Observation] = []
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
            found.append(Observation(name, max(time - since, 0.0) if stamped else time, phase == Phase.FAILED))
        if stamped and isinstance(symbol := record.get("symbol"), str) and symbol:
            command = symbol.removesuffix("_done").removesuffix("_failed")
            key = f"{net} {command}"
            if command == symbol:
                begun[key].append(time)
            elif begun[key]:
                commands[command].append(max(time - begun[key].popleft(), 0.0))
    return Measurement(tuple(found), {command: tuple(times) for command, times in commands.items()})
