"""A run of the benchmarks: its figures with the computer's own yardstick, as a file and as a table."""

import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Self, TypeVar

import pydantic

from bench.figures import Line, readable
from im_core.config import Model, faults
from im_core.errors import ImError
from im_core.files import FileError, write_whole
from im_core.text.jsontext import load_json

LOOP = "Python loop of 10^7 additions"
ModelT = TypeVar("ModelT", bound=Model)
_QUIET = 0.5
"""Load average a processor below which the computer does nothing else."""


class Row(Model):
    """A figure: a :class:`bench.figures.Line` with its verdict. A figure that is not finite counts as not measured."""

    name: str
    value: float | None
    unit: str
    baseline: float | None
    against: str
    bar: float | None
    at_least: bool

    @classmethod
    def of(cls, line: Line) -> Self:
        """The row of a line."""
        values = {**asdict(line)}
        for key in ("value", "baseline"):
            number = values[key]
            if number is not None and not math.isfinite(number):
                values |= {key: None, "against": f"{number} {line.against}".strip()}
        return cls(**values)

    @property
    def line(self) -> Line:
        """The line of this row, which knows ratio and verdict."""
        return Line(**self.model_dump())


class StepResult(Model):
    """What a step came to.

    Attributes:
        title: The step, as one would type it.
        part: Name of the part.
        when: When it began, since 1970 [s].
        seconds: How long it took [s].
        failure: Why there are no figures; empty: there are.
        rows: The figures.
        code: With which its process ended: 1 tells of a missed bar, or of a group that could not be measured.
    """

    title: str
    part: str
    when: float
    seconds: float
    failure: str
    rows: list[Row]
    code: int = 0

    @property
    def unmeasured(self) -> int:
        """How many figures could not be measured; their rows say why."""
        return sum(row.value is None for row in self.rows)

    @property
    def good(self) -> bool:
        """Whether there are figures, all groups could be measured, and no bar is missed."""
        return not self.failure and self.code == 0 and not any(row.line.met is False for row in self.rows)


class Run(Model):
    """A run of all benchmarks.

    Attributes:
        commit: Of the sources, ``+`` at its end: and changes since.
        when: When it began, since 1970 [s].
        kind: ``quick``, ``full`` or the parts that were named.
        yardstick: What the computer is worth, measured before.
        steps: What was measured.
    """

    commit: str
    when: float
    kind: str
    yardstick: list[Row]
    steps: list[StepResult]

    @property
    def date(self) -> str:
        """Day and time, UTC."""
        return time.strftime("%Y-%m-%d %H:%M", time.gmtime(self.when))

    @property
    def loop_s(self) -> float:
        """The Python loop of the yardstick [s]; 1 where there is none."""
        return next((row.value for row in self.yardstick if row.name == LOOP and row.value), 1.0)

    def row(self, part: str, name: str) -> Row | None:
        """The first figure of a part whose name begins so."""
        rows = (row for step in self.steps if step.part == part for row in step.rows)
        return next((row for row in rows if row.name.strip().startswith(name)), None)


def write(run: Run, folder: Path) -> list[Path]:
    """Writes ``<stamp>.json`` and ``<stamp>.md``."""
    folder.mkdir(parents=True, exist_ok=True)
    stamp = folder / time.strftime("%Y%m%d-%H%M%S", time.localtime(run.when))
    content = json.dumps(run.model_dump(), indent=1, allow_nan=False) + "\n"
    return [
        write_whole(stamp.with_suffix(".json"), content),
        write_whole(stamp.with_suffix(".md"), f"# Benchmarks\n\n{markdown(run)}"),
    ]


def load(path: Path) -> Run:
    """A run that :func:`write` wrote.

    Raises:
        FileError: It cannot be read, or is none.
    """
    return validated(path, Run)


def together(runs: Sequence[Run]) -> Run:
    """One run of several of the same sources: of each part what was measured last, with the last run's yardstick.

    Raises:
        ImError: They are of different commits.
    """
    ordered = sorted(runs, key=lambda each: each.when)
    commits = list(dict.fromkeys(each.commit for each in ordered))
    if len(commits) > 1:
        raise ImError(f"runs of different commits do not make one table: {', '.join(commits)}")
    steps = {step.part: step for each in ordered for step in each.steps}
    kinds = "; ".join(each.kind for each in ordered)
    return ordered[-1].model_copy(update={"steps": list(steps.values()), "kind": kinds})


def validated(path: Path, model: type[ModelT]) -> ModelT:
    """Data of a JSON file.

    Raises:
        FileError: It cannot be read, is no JSON, or not of this model; the field is named.
    """
    content = load_json(path)
    try:
        return model.model_validate(content)
    except pydantic.ValidationError as error:
        first = faults(error, model)[0]
        raise FileError(path, f"{first.field or 'the file'}: {first.sentence}") from error


def markdown(run: Run) -> str:
    """The yardstick, what is missed or failed, and a table for each step."""
    return "\n".join([_heading(run), _table(run.yardstick, ""), *map(_step, run.steps)])


def _heading(run: Run) -> str:
    rows = [row for step in run.steps for row in step.rows]
    bars = [row.line.met for row in rows if row.line.met is not None]
    failed = [step for step in run.steps if step.failure]
    counts = f"{len(rows)} figures, {len(bars)} with a bar, **{bars.count(False)} missed**"
    unmeasured = sum(step.unmeasured for step in run.steps)
    if unmeasured:
        counts += f", **{unmeasured} could not be measured**"
    if failed:
        counts += f", **{len(failed)} parts failed**: " + ", ".join(f"`{step.title}`" for step in failed)
    return f"{run.date} UTC, commit `{run.commit}`, {run.kind}. {_load(run)} {counts}.\n"


def _load(run: Run) -> str:
    """How much else ran, in words: who reads wall times must know."""
    loads = [row for row in run.yardstick if row.name == "load average"]
    loads += [row for step in run.steps for row in step.rows if row.name.startswith("load average before")]
    values = [row.value for row in loads if row.value is not None]
    processors = next((int(row.against.split()[0]) for row in loads if row.against[:1].isdigit()), 1)
    if not values:
        return "How much else ran is not known."
    text = f"Load average before the parts {min(values):.1f} to {max(values):.1f} on {processors} processors"
    if values[0] <= _QUIET * processors:
        return f"{text}."
    return f"{text}: **other programs ran, and wall times say little**; CPU times and ratios do."


def _step(step: StepResult) -> str:
    title = f"\n### `scripts/bench.sh {step.title}`\n\n"
    if step.failure:
        return f"{title}**Failed** after {step.seconds:.0f} s: {_cell(step.failure)}\n"
    return title + _table(step.rows, time.strftime("%m-%d %H:%M", time.gmtime(step.when)))


def _table(rows: Sequence[Row], when: str) -> str:
    shown = [row for row in rows if when == "" or not row.name.startswith("load average")]
    columns = ["what", "this", "peer or limit", "ratio", "bar", "", *(["when"] if when else [])]
    aligned = [":--", "--:", ":--", "--:", "--:", ":--", *([":--"] if when else [])]
    lines = [_cells(columns), _cells(aligned)]
    lines += [_cells([*_row(row), *([when] if when else [])]) for row in shown]
    return "\n".join(lines) + "\n"


def _row(row: Row) -> list[str]:
    line = row.line
    indent = "&nbsp;" * (len(row.name) - len(row.name.lstrip()))
    value = "-" if line.value is None else f"{readable(line.value)} {line.unit}".strip()
    against = _cell(row.against)
    if line.baseline is not None:
        against = f"{against}: {readable(line.baseline)} {line.unit}".strip()
    ratio = "" if line.baseline is None or line.measure is None else f"{line.measure:.3g}"
    bar = "" if line.bar is None else f"{'≥' if line.at_least else '≤'} {line.bar:,g}"
    verdict = {None: "" if line.value is not None else "not measured", True: "ok", False: "**missed**"}[line.met]
    return [indent + _cell(row.name.strip()), value, against, ratio, bar, verdict]


def _cells(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(text: str) -> str:
    """A text that does not end its cell."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
