"""Lines of a benchmark: a figure with a baseline of the same run, and a bar that it should meet."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from im_core.clock import stamp_name
from im_core.errors import ImError
from im_core.files import write_whole
from im_core.names import results_dir


@dataclass(frozen=True)
class Line:
    """One figure of a benchmark.

    Attributes:
        name: What was measured.
        value: The figure; None: it could not be measured, and ``against`` says why.
        unit: Its unit.
        baseline: The same quantity of something simple, measured in the same run; the ratio says more than the value.
        against: What the baseline is.
        bar: What the ratio (without baseline, the value) must not exceed, or must reach if ``at_least``; None: no bar.
        at_least: Whether the bar is a lower bound.
    """

    name: str
    value: float | None
    unit: str
    baseline: float | None = None
    against: str = ""
    bar: float | None = None
    at_least: bool = False

    @classmethod
    def read(cls, entry: dict[str, Any]) -> "Line":
        """A line that :func:`write` wrote."""
        return cls(**{field.name: entry[field.name] for field in fields(cls)})

    @property
    def measure(self) -> float | None:
        """What the bar is for: the ratio to the baseline, or the value if there is none."""
        if self.value is None or self.baseline is None:
            return self.value
        return self.value / self.baseline

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None if there is no bar, or nothing was measured."""
        if self.bar is None or self.measure is None:
            return None
        return self.measure >= self.bar if self.at_least else self.measure <= self.bar

    def text(self, width: int = 34) -> str:
        """The line for the terminal.

        Args:
            width: Columns of the name.
        """
        value = "-" if self.value is None else readable(self.value)
        note = self.against
        if self.measure is not None and self.baseline is not None:
            note = f"{self.measure:.4g} x {self.against} ({readable(self.baseline)} {self.unit})"
        verdict = {None: "", True: "ok", False: "MISSED"}[self.met]
        sign = ">=" if self.at_least else "<="
        bar = "" if self.bar is None else f"{sign} {self.bar:,g}"
        return f"{self.name:<{width}}{value:>10} {self.unit:<5}{bar:>9} {verdict:<7}{note}".rstrip()


def readable(value: float) -> str:
    """A number as a table shows it."""
    return f"{value:,.0f}" if abs(value) >= 10_000 else f"{value:.4g}"


@dataclass(frozen=True)
class Measured:
    """What measuring came to.

    Attributes:
        lines: All figures.
        failed: Whether one could not be measured because something did not work.
    """

    lines: list[Line]
    failed: bool

    @property
    def good(self) -> bool:
        """Whether everything worked, and no bar was missed."""
        return not self.failed and all(line.met is not False for line in self.lines)


def measure(work: Mapping[str, Callable[[], list[Line]]], names: Sequence[str]) -> Measured:
    """Measure parts of a benchmark; one that fails does not keep the others from being measured.

    Args:
        work: What measures each part, by its name.
        names: Parts to measure.

    Returns:
        The lines, between the load averages before and after.
    """
    lines = [Line(f"load average before, {os.cpu_count()} CPUs", os.getloadavg()[0], "")]
    failed = False
    for name in names:
        print(f"bench: {name}", flush=True)
        try:
            lines += work[name]()
        except ImError as error:
            failed = True
            lines.append(Line(name, None, "", None, error.message))
    lines.append(Line("load average after", os.getloadavg()[0], ""))
    return Measured(lines, failed)


def table(lines: Sequence[Line]) -> str:
    """All lines, and how many bars were missed."""
    width = max([34, *(len(line.name) + 1 for line in lines)])
    missed = sum(line.met is False for line in lines)
    closing = "all bars are met" if missed == 0 else f"{missed} bars are missed"
    unmeasured = sum(line.value is None for line in lines)
    if unmeasured:
        closing += f", {unmeasured} figures could not be measured"
    return "\n".join([*(line.text(width) for line in lines), closing])


def measured_by_machine(*arguments: str) -> list[Line]:
    """What the bench of the whole machine says, ``python -m bench.machine``.

    Args:
        arguments: Its arguments, besides ``--lines FILE``.

    Raises:
        ImError: It failed.
    """
    with tempfile.TemporaryDirectory(prefix="im_bench_") as folder:
        file = Path(folder) / "lines.json"
        ended = subprocess.run([sys.executable, "-m", "bench.machine", *arguments, "--lines", str(file)], check=False)
        if not file.is_file():
            raise ImError(f"the bench of the machine ended with code {ended.returncode}, without figures")
        return read(file)


def report(name: str, lines: Sequence[Line]) -> None:
    """Print the lines, and keep them in ``results/<name>-<date>-<time>.json``."""
    print(table(lines))
    path = results_dir() / f"{name}-{stamp_name()}.json"
    write(path, lines)
    print(f"bench: {path}")


def read(path: Path) -> list[Line]:
    """The lines that :func:`write` wrote."""
    return [Line.read(entry) for entry in json.loads(path.read_text(encoding="utf-8"))]


def write(path: Path, lines: Sequence[Line]) -> None:
    """Writes the lines as a JSON list."""
    content = [{**asdict(line), "measure": line.measure, "met": line.met} for line in lines]
    write_whole(path, json.dumps(content, indent=2) + "\n")
