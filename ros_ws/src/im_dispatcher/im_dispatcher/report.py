"""Times of a command's steps, and the report on disk."""

import itertools
import json
import os
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from im_cell.calibration_summary import summary
from im_core.errors import StoreError
from im_core.files import make_folder, synchronise_names, write_whole
from im_pnt.model.net import Net

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


#: Transitions under way that are remembered: anybody may tell of some that never end.
MOST_STARTED = 1000


@dataclass
class StepTimes:
    """Sums of the firings of one command by transition; composite ones count the whole duration.

    Attributes:
        nets: Returns the net of the command and all nets required by it, as written; none before it is loaded.
        now: Returns the testbed time [s].
        steps: By transition.
        command: Number of the command; those of others, which may run beside it, are not counted.
    """

    nets: Callable[[], Sequence[Net]] = lambda: ()
    now: Callable[[], float] = lambda: 0.0
    steps: dict[str, StepTime] = field(default_factory=lambda: defaultdict(StepTime))
    command: int = 0
    _started: dict[tuple[str, int], float] = field(default_factory=dict)

    def restart(self, command: int) -> None:
        """Count the firings of another command from now on; running ones count from the begin."""
        self.command = command
        self.steps.clear()

    def is_step(self, net: str, transition: str) -> bool:
        """Return whether a transition belongs to the nets of the command: firings come from any sender."""
        known = f"{net}.{transition}" in self.steps
        return known or any(each.name == net and transition in each.transitions for each in self.nets())

    def note_start(self, transition: str, command: int, stamp_s: float) -> None:
        """Note the start of a transition for a command at a testbed time [s]."""
        self._started[transition, command] = stamp_s
        if len(self._started) > MOST_STARTED:
            del self._started[next(iter(self._started))]

    def note_end(self, transition: str, command: int, stamp_s: float, wall_s: float) -> None:
        """Note an end or failure at a testbed time [s], after ``wall_s`` of wall time."""
        began_s = self._started.pop((transition, command), stamp_s)
        if command == self.command:
            step = self.steps[transition]
            step.count += 1
            step.wall_s += wall_s
            step.simulated_s += stamp_s - began_s

    def to_dict(self) -> dict[str, list[float]]:
        """Return the times as JSON data, without running steps."""
        return {name: [step.count, step.wall_s, step.simulated_s] for name, step in self.steps.items()}

    def add_times(self, times: object) -> None:
        """Add times written by :meth:`to_dict`; nothing for other data."""
        for name, time in times.items() if isinstance(times, dict) else ():
            count, wall_s, simulated_s = time
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


def succeeded(solver: Mapping[str, object], skipped: Sequence[Mapping[str, object]], poses: int) -> dict[str, object]:
    """Return the report of a command with a successful calibration.

    Args:
        solver: What the calibration reports.
        skipped: Poses that it was not given, each an ``im_msgs/msg/Rejection``.
        poses: How many were asked for.
    """
    rejected = solver.get("points_rejected", [])
    assert isinstance(rejected, list)
    return {**solver, "points_rejected": [*rejected, *skipped], "poses": poses}


def failed(reason: str, skipped: Sequence[Mapping[str, object]]) -> dict[str, object]:
    """Return the report of a failed command."""
    return {"success": False, "message": reason, "points_used": 0, "points_rejected": list(skipped)}


def make_directory(results: Path, stamp: str) -> Path:
    """Make a new folder ``results/<stamp>``, with a counter appended for two runs in one second.

    Raises:
        StoreError: It cannot be made.
    """
    make_folder(results)
    for attempt in itertools.count():
        path = results / (stamp if attempt == 0 else f"{stamp}-{attempt}")
        try:
            path.mkdir()
            synchronise_names(results)
        except FileExistsError:
            continue
        except OSError as error:
            raise StoreError.of("made", path, error) from error
        break
    return path


def write_report(directory: Path, report: Mapping[str, object]) -> Path:
    """Write ``report.json`` and ``summary.txt`` of it, and point the link ``latest`` beside the folder to the folder.

    Each file is written whole or not at all; there is no summary of a command without cameras.

    Raises:
        StoreError: They cannot be written; ``latest`` is what it was.
        DataError: A part of the report is missing, or of another kind.
    """
    text = summary(report) if report.get("cameras") else ""
    path = write_whole(directory / "report.json", json.dumps(report, indent=2, allow_nan=False) + "\n")
    if text:
        write_whole(directory / "summary.txt", text)
    link = directory.parent / f".{LATEST}.{os.getpid()}"
    try:
        link.unlink(missing_ok=True)
        link.symlink_to(directory.name)
        os.replace(link, directory.parent / LATEST)
        synchronise_names(directory.parent)
    except OSError as error:
        raise StoreError.of("written", directory.parent / LATEST, error) from error
    return path
