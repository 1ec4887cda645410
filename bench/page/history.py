"""Figures that are followed over versions: their history, a file that is committed, and its drawing."""

import io
import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.page.run import Run, validated
from im_core.config import Model
from im_core.files import write_whole


@dataclass(frozen=True)
class Followed:
    """A figure that is followed.

    Attributes:
        label: What the drawing calls it.
        part: The part that measures it.
        name: How its row begins.
        loops: Whether it is a time that is given in Python loops of the yardstick, whatever its baseline.
    """

    label: str
    part: str
    name: str
    loops: bool = False

    def value(self, run: Run) -> float | None:
        """What the bar is for, the ratio or the value; a time in loops. None: not measured."""
        row = run.row(self.part, self.name)
        if row is None or row.value is None:
            return None
        return row.value / run.loop_s if self.loops else row.line.measure


FOLLOWED = (
    Followed("limit over command (1 is the limit)", "machine", "limit of the command"),
    Followed("command's CPU [Python loops]", "machine", "CPU time of all processes", loops=True),
    Followed("start [Python loops]", "machine", "start,", loops=True),
    Followed("memory [MiB]", "machine", "memory after"),
    Followed("lockstep, times real time", "mcs", "lockstep"),
    Followed("servo tick, median [Python loops / 1000]", "mcs", "p50", loops=True),
    Followed("firings for a command over SNAKES", "nets", "100 places, tokens alone, against SNAKES"),
    Followed("frames a second over bare pybullet", "vss", "egl: frames of one camera, an arm moves"),
    Followed("CPU of a put over a bare service's", "dom", "put, 64 on their way: CPU"),
)


class Version(Model):
    """What one version was worth.

    Attributes:
        commit: Of the sources.
        when: When it was measured, since 1970 [s].
        load: Load average before.
        loop_s: The Python loop of the yardstick [s].
        figures: Of :data:`FOLLOWED`, by label.
    """

    commit: str
    when: float
    load: float
    loop_s: float
    figures: dict[str, float]


class History(Model):
    """What versions were worth, oldest first."""

    versions: list[Version]


def read(path: Path) -> History:
    """The history of a file; one without versions, where there is no file yet.

    Raises:
        FileError: It cannot be read, or is damaged: file and field are named.
    """
    return validated(path, History) if path.exists() else History(versions=[])


def with_run(history: History, run: Run) -> History:
    """The history with a run; in place of a former one of the same commit.

    Args:
        history: As read.
        run: What was measured; a figure that it lacks stays as it was measured for that commit before.
    """
    before = next((version for version in history.versions if version.commit == run.commit), None)
    measured = {each.label: each.value(run) for each in FOLLOWED}
    figures = {label: float(f"{value:.4g}") for label, value in measured.items() if value is not None}
    load = next((row.value for row in run.yardstick if row.name == "load average"), None) or 0.0
    made = Version(
        commit=run.commit,
        when=round(run.when),
        load=round(load, 2),
        loop_s=round(run.loop_s, 4),
        figures={**(before.figures if before else {}), **figures},
    )
    others = [version for version in history.versions if version.commit != run.commit]
    return History(versions=sorted([*others, made], key=lambda version: version.when))


def write(history: History, path: Path) -> Path:
    """Writes the history."""
    return write_whole(path, json.dumps(history.model_dump(), indent=1, allow_nan=False) + "\n")


def draw(history: History, path: Path) -> Path:
    """Draws a panel for each figure: its value over the versions; a filled mark was measured on a quiet computer.

    Args:
        history: What is drawn.
        path: An SVG file.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = 3
    rows = math.ceil(len(FOLLOWED) / columns)
    drawing = io.BytesIO()
    # a salt, so that the same history is the same file
    with rc_context({"svg.hashsalt": "im", "svg.fonttype": "none", "font.size": 8}):
        figure = Figure(figsize=(10.0, 2.2 * rows), layout="constrained")
        FigureCanvasAgg(figure)
        for number, followed in enumerate(FOLLOWED):
            _panel(figure.add_subplot(rows, columns, number + 1), followed.label, history.versions)
        figure.savefig(drawing, format="svg", metadata={"Date": None})
    return write_whole(path, drawing.getvalue())


def _panel(axes: Any, label: str, versions: Sequence[Version]) -> None:
    points = [(n, version.figures[label]) for n, version in enumerate(versions) if label in version.figures]
    axes.plot([n for n, _ in points], [value for _, value in points], "-", color="#bcd3ea")
    for quiet, face in ((True, "#2b6cb0"), (False, "white")):
        marks = [(n, value) for n, value in points if (versions[n].load < 1.0) == quiet]
        axes.plot([n for n, _ in marks], [v for _, v in marks], "o", color="#2b6cb0", markerfacecolor=face)
    axes.set_title(label)
    axes.set_xticks(range(len(versions)), [_name(version) for version in versions])
    axes.set_xlim(-0.5, max(0.5, len(versions) - 0.5))
    axes.set_ylim(0.0, 1.15 * max([value for _, value in points], default=1.0))


def _name(version: Version) -> str:
    return f"{version.commit[:8]}\n{time.strftime('%Y-%m-%d', time.gmtime(version.when))}"
