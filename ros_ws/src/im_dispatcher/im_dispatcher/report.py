"""Where the time of a command went, and its report on disk."""

import json
import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from im_core.files import write_whole

LATEST = "latest"


@dataclass
class StepTime:
    """Time spent in one transition.

    Attributes:
        count: How often it ended or failed.
        wall_s: Wall time [s].
        simulated_s: Testbed time [s].
    """

    count: int = 0
    wall_s: float = 0.0
    simulated_s: float = 0.0


@dataclass
class StepTimes:
    """Adds up firings by transition; transitions that contain others count their whole duration."""

    steps: dict[str, StepTime] = field(default_factory=lambda: defaultdict(StepTime))
    _started: dict[str, float] = field(default_factory=dict)

    def start(self, transition: str, stamp_s: float) -> None:
        """A transition began at a testbed time [s]."""
        self._started[transition] = stamp_s

    def end(self, transition: str, stamp_s: float, wall_s: float) -> None:
        """It ended or failed at a testbed time [s], after ``wall_s`` of wall time."""
        step = self.steps[transition]
        step.count += 1
        step.wall_s += wall_s
        step.simulated_s += stamp_s - self._started.pop(transition, stamp_s)

    def to_dict(self) -> dict[str, list[float]]:
        """The times as JSON data; what runs is not in them."""
        return {name: [step.count, step.wall_s, step.simulated_s] for name, step in self.steps.items()}

    def add(self, times: Mapping[str, Sequence[float]]) -> None:
        """Adds the times that :meth:`to_dict` wrote."""
        for name, (count, wall_s, simulated_s) in times.items():
            step = self.steps[name]
            step.count += int(count)
            step.wall_s += wall_s
            step.simulated_s += simulated_s

    def summary(self, wall_s: float, simulated_s: float) -> dict[str, object]:
        """For the report; the longest step first."""
        ordered = sorted(self.steps.items(), key=lambda item: -item[1].wall_s)
        return {
            "wall_s": round(wall_s, 3),
            "simulated_s": round(simulated_s, 6),
            "simulated_over_wall": round(simulated_s / wall_s, 3) if wall_s > 0.0 else None,
            "steps": {
                name: {
                    "count": step.count,
                    "wall_s": round(step.wall_s, 3),
                    "simulated_s": round(step.simulated_s, 6),
                }
                for name, step in ordered
                if step.wall_s > 0.0
            },
        }


def make_directory(results: Path, stamp: str) -> Path:
    """A new folder ``results/<stamp>``, with a counter behind it when two runs share a second."""
    for attempt in range(1000):
        path = results / (stamp if attempt == 0 else f"{stamp}-{attempt}")
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        return path
    raise FileExistsError(f"{results}/{stamp} and a thousand like it exist")


def write_report(directory: Path, report: Mapping[str, object]) -> Path:
    """Write ``report.json`` at one stroke, and let ``latest`` beside the folder point to it."""
    path = write_whole(directory / "report.json", json.dumps(report, indent=2, allow_nan=False) + "\n")
    link = directory.parent / f".{LATEST}.{os.getpid()}"
    link.unlink(missing_ok=True)
    link.symlink_to(directory.name)
    os.replace(link, directory.parent / LATEST)
    return path
