"""What a run of all benchmarks consists of, short and long; and how one of its steps is carried out."""

import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.figures import read
from bench.page.run import Row, StepResult
from im_core import clock
from im_core.errors import ImError

_END_S = 60.0


@dataclass(frozen=True)
class Step:
    """One part, as ``python -m bench.PART`` with some arguments.

    Attributes:
        part: Its name.
        arguments: Groups and options; after them come those of ``bench/part.py``.
        limit_s: After how long it is given up [s]: long enough for a computer that does much else.
    """

    part: str
    arguments: tuple[str, ...] = ()
    limit_s: float = 3600.0

    @property
    def title(self) -> str:
        """As one would type it."""
        return " ".join(["--" + self.part, *self.arguments])


QUICK = (
    Step("machine", ("--runs", "1")),
    Step("mcs", ("tracking", "line", "tick", "process", "durations", "lockstep")),
    Step("nets", ("--quick",)),
    Step("vss", ("cameras",)),
    Step("dom", ("--kills", "20")),
    Step("bag", ("--seconds", "60")),
    Step("sizes", ("--quick",)),
    Step("spot", ("--trials", "300", "--frames", "100")),
    Step("strategies"),
    Step("calibration", ("errors", "--kind", "everything", "--trials", "3")),
)
"""About ten minutes on two cores that do nothing else."""

FULL = (
    Step("machine", ("command", "rest", "real-time", "pairs", "--seeds", "5"), 7200.0),
    Step("sizes", (), 7200.0),
    Step("mcs", (), 7200.0),
    Step("nets", (), 7200.0),
    Step("vss", (), 7200.0),
    Step("dom"),
    Step("bag"),
    Step("display"),
    Step("spot"),
    Step("strategies"),
    Step("calibration", ("errors", "noise", "verdicts", "poses"), 14400.0),
    Step("soak", ("--runs", "20"), 14400.0),
)
"""Everything but what takes days: an hour and more."""


def carry_out(step: Step, command: Sequence[str] = (sys.executable, "-m")) -> StepResult:
    """Runs a step in a process of its own, whose output shows how far it is.

    What does not work is part of the result: a step that ends without figures, or does not end.

    Args:
        step: The step.
        command: What ``bench.PART`` is given to.
    """
    when, began = clock.wall(), clock.monotonic()
    with tempfile.TemporaryDirectory(prefix="im_bench_") as folder:
        file, errors = Path(folder) / "lines.json", Path(folder) / "errors.txt"
        arguments = [*command, f"bench.{step.part}", *step.arguments, "--lines", str(file)]
        with errors.open("wb") as sink:
            process = subprocess.Popen(arguments, stderr=sink, stdin=subprocess.DEVNULL, preexec_fn=_heed_interrupts)
            failure = _await(process, step.limit_s)
        said = errors.read_text(encoding="utf-8", errors="replace").strip()
        rows: list[Row] = []
        if not failure and file.is_file():
            rows = [Row.of(line) for line in read(file)]
        elif not failure:
            last = said.rpartition("\n")[2] or "it says nothing"
            failure = f"ended with code {process.returncode}, without figures: {last}"
    if said:
        print(said, file=sys.stderr, flush=True)
    return StepResult(
        title=step.title,
        part=step.part,
        when=when,
        seconds=clock.monotonic() - began,
        failure=failure,
        rows=rows,
        code=process.returncode,
    )


def _heed_interrupts() -> None:
    """A shell has what it runs in the background ignore interrupts, which is inherited."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _await(process: subprocess.Popen[bytes], limit_s: float) -> str:
    """Waits for the end of a step; why it was ended, or nothing.

    Raises:
        KeyboardInterrupt: The user wants no more; the step has been ended.
    """
    try:
        process.wait(limit_s)
    except subprocess.TimeoutExpired:
        _end(process)
        return f"not done after {limit_s:g} s"
    except BaseException:
        _end(process)
        raise
    return ""


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends a step: first so that it can stop the machine that it has started."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def chosen(steps: Sequence[Step], only: Sequence[str]) -> list[Step]:
    """The steps of some parts; of all, where none is named.

    Raises:
        ImError: There is no such part.
    """
    parts = {step.part for step in steps}
    unknown = [part for part in only if part not in parts]
    if unknown:
        raise ImError(f"--only {unknown[0]}: there is no such part; there are {', '.join(sorted(parts))}")
    return [step for step in steps if not only or step.part in only]
