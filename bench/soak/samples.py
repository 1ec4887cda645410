"""What a machine holds at a moment, and whether that grows: a straight line through the samples, and its error."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from scipy import stats

from bench.figures import Line
from bench.usage import own_memory_mib, program
from im_core import names

WEEK_S = 7 * 86_400.0
_SHM = Path("/dev/shm")


@dataclass(frozen=True)
class Sample:
    """What all processes of a machine hold together.

    Attributes:
        kind: Of the command before it.
        at_s: When, since the first command began [s].
        duration_s: How long the command before it took [s].
        memory: Anonymous pages, swapped ones too [MiB].
        descriptors: Open files.
        threads: Threads.
        shm: Files in ``/dev/shm`` that they have in their memory, each once [MiB].
        disk: Folder of logs, journals and data objects [MiB].
        memory_of: That of each process, by its program and number [MiB].
    """

    kind: str
    at_s: float
    duration_s: float
    memory: float
    descriptors: float
    threads: float
    shm: float
    disk: float
    memory_of: Mapping[str, float] = field(default_factory=dict)


_WARM_UP = 0.1


@dataclass(frozen=True)
class Quantity:
    """A field of :class:`Sample` that is judged.

    Attributes:
        name: The field.
        unit: Its unit.
        week: Growth in a week that is no trouble.
        warm_up: Share of the samples that is left out: until then it fills.
    """

    name: str
    unit: str
    week: float
    warm_up: float = _WARM_UP


#: What a week may add: a quarter of a machine's memory; on the disk, what its logs may hold with those before them; and
#: no files, threads or shared memory to speak of.
QUANTITIES = (
    Quantity("memory", "MiB", 512.0),
    Quantity("descriptors", "", 64.0),
    Quantity("threads", "", 16.0),
    Quantity("shm", "MiB", 64.0),
    Quantity("disk", "MiB", 512.0, warm_up=0.5),  # how the last hundred commands have ended is kept
)
#: A command may take so much longer after a week, as a share of the mean of its kind.
LONGER = 0.1


@dataclass(frozen=True)
class Trend:
    """A straight line through values over time.

    Attributes:
        mean: Mean of the values.
        slope: Growth [1/s].
        low: Lower end of the 95 % interval of the slope [1/s]; minus infinity with fewer than three values.
        high: Upper end [1/s].
    """

    mean: float
    slope: float
    low: float
    high: float

    @property
    def in_a_week(self) -> str:
        """Growth in a week and its 95 % interval, in words."""
        estimate, low, high = (WEEK_S * slope for slope in (self.slope, self.low, self.high))
        return f"{estimate:+.3g}, 95 %: {low:+.3g} to {high:+.3g}"

    @classmethod
    def through(cls, at_s: Sequence[float], values: Sequence[float]) -> "Trend":
        """Least squares; the interval is Student's, of the scatter about the line.

        What a machine holds changes in steps, so that values that follow each other are off the line together and tell
        less than their number. They count as the independent ones that would tell as much, with the correlation of
        neighbours (Santer et al., J. Geophys. Res. 105, 2000, eq. 6), three at least.
        """
        if len(values) < 3:
            return cls(math.nan, math.nan, -math.inf, math.inf)
        mean, apart = float(np.mean(values)), np.subtract(at_s, np.mean(at_s))
        spread = float(apart @ apart)
        slope = float(apart @ np.subtract(values, mean)) / spread
        rest = np.subtract(values, mean) - slope * apart
        scatter = float(rest @ rest)
        together = max(0.0, float(rest[1:] @ rest[:-1]) / scatter) if scatter else 0.0
        degrees = max(3.0, len(values) * (1.0 - together) / (1.0 + together)) - 2.0
        reach = float(stats.t.ppf(0.975, degrees)) * math.sqrt(scatter / degrees / spread)
        return cls(mean, slope, slope - reach, slope + reach)


def sample(pids: Iterable[int], kind: str, at_s: float, duration_s: float) -> Sample:
    """Look at processes, and at the folders of the machine of this ROS domain."""
    found = list(pids)
    memory_of = {f"{program(pid)} {pid}": own_memory_mib([pid]) for pid in found}
    return Sample(
        kind,
        at_s,
        duration_s,
        sum(memory_of.values()),
        float(sum(_entries(pid, "fd") for pid in found)),
        float(sum(_entries(pid, "task") for pid in found)),
        _mib(_SHM / name for name in {name for pid in found for name in _mapped(pid)}),
        _mib(path for path in names.run_dir().rglob("*") if path.is_file()),
        memory_of,
    )


def after_warm_up(samples: Sequence[Sample], share: float = _WARM_UP) -> list[Sample]:
    """Without the first share, three at least: caches fill, and modules are loaded with the first that needs them."""
    return list(samples[max(3, int(len(samples) * share)) :])


def lines(samples: Sequence[Sample]) -> list[Line]:
    """Growth in a week of everything, as far as it is certain, with the estimate and its interval.

    The bar is for what has surely grown: the lower end of the 95 % interval. A run that is too short proves nothing,
    and its wide interval says so.
    """
    used = after_warm_up(samples)
    at_s = [each.at_s for each in used]
    result = []
    for quantity in QUANTITIES:
        settled = after_warm_up(samples, quantity.warm_up)
        trend = Trend.through([each.at_s for each in settled], [getattr(each, quantity.name) for each in settled])
        result += _of(quantity.name, quantity.unit, trend, quantity.week)
    result += _of_each_process(used)
    kinds = {each.kind for each in used}
    means = {kind: float(np.mean([each.duration_s for each in used if each.kind == kind])) for kind in kinds}
    trend = Trend.through(at_s, [each.duration_s / means[each.kind] for each in used])
    return result + _of("duration over the mean of its kind", "", trend, LONGER)


def _of(name: str, unit: str, trend: Trend, bar: float) -> list[Line]:
    if not math.isfinite(trend.low):
        return [Line(f"{name}, in a week", None, unit, against="too few commands: three after the warm-up are needed")]
    sure = max(0.0, WEEK_S * trend.low)
    return [
        Line(f"{name}, mean", trend.mean, unit),
        Line("  surely grown in a week", sure, unit, bar=bar, against=f"estimate {trend.in_a_week}"),
    ]


def _of_each_process(samples: Sequence[Sample]) -> list[Line]:
    """What each process that lived throughout takes, and how that grows: which of them it is."""
    at_s = [each.at_s for each in samples]
    throughout = (
        [name for name in samples[0].memory_of if all(name in each.memory_of for each in samples)] if samples else []
    )
    result = []
    for name in throughout:
        trend = Trend.through(at_s, [each.memory_of[name] for each in samples])
        if math.isfinite(trend.low):
            grows = f"in a week {trend.in_a_week}"
            result.append(Line(f"  of {name.rpartition(' ')[0]}, mean", trend.mean, "MiB", against=grows))
    return result


def table(samples: Sequence[Sample]) -> list[dict[str, object]]:
    """All samples, for the file of the figures."""
    return [{each.name: getattr(one, each.name) for each in fields(Sample)} for one in samples]


def _entries(pid: int, folder: str) -> int:
    try:
        return len(list(Path(f"/proc/{pid}/{folder}").iterdir()))
    except OSError:
        return 0


def _mapped(pid: int) -> set[str]:
    try:
        maps = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return set()
    return set(re.findall(r"/dev/shm/(\S+)", maps))


def _mib(paths: Iterable[Path]) -> float:
    total = 0
    for path in paths:
        try:
            total += 512 * path.stat().st_blocks
        except OSError:  # it has gone
            continue
    return total / 2**20
