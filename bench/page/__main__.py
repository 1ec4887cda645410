"""``python -m bench.page``: all benchmarks in one table; for ``scripts/bench.sh`` without a part."""

import argparse
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from bench import yardstick
from bench.figures import table
from bench.page import history, run
from bench.page.docs import document
from bench.page.plan import FULL, QUICK, Step, carry_out, chosen
from bench.page.run import Row, Run
from im_bringup.machine.interrupts import interrupt_once
from im_core import clock
from im_core.errors import ImError
from im_core.names import results_dir

ROOT = Path(__file__).resolve().parents[2]

_DESCRIPTION = """Runs all benchmarks, one after the other, and gives one table: what, this, peer or limit, ratio, bar,
when. It is printed and kept in results/bench/<date>-<time>.json and .md. A part that fails is shown with its reason;
the others go on. Ratios are to baselines of the same run; the yardstick says what the computer is worth."""

_EPILOG = """steps of --quick:
{quick}
steps without it:
{full}

Exit codes: 0 all bars that could be measured are met, 1 a bar is missed or a part failed, 2 bad usage, 130 interrupted
(what was measured until then is kept)."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="bench",
        description=_DESCRIPTION,
        epilog=_EPILOG.format(quick=_told(QUICK), full=_told(FULL)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="about ten minutes on two quiet cores instead of hours")
    parser.add_argument("--only", nargs="+", default=[], metavar="PART", help="only these parts")
    parser.add_argument(
        "--docs", action="store_true", help="show the figures in docs/performance.md, and add them to its history"
    )
    parser.add_argument(
        "--from",
        dest="former",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="measure nothing: show runs of results/bench again, of each part the last",
    )
    options = parser.parse_args(arguments)
    interrupt_once()
    try:
        steps = chosen(QUICK if options.quick else FULL, options.only)
        past = history.read(ROOT / "docs" / "performance.json") if options.docs else history.History(versions=[])
        former = run.together([run.load(path) for path in options.former]) if options.former else None
    except ImError as error:
        parser.error(error.message)
    interrupted = False
    if former is None:
        kind = "quick" if options.quick else "full"
        former, interrupted = _measured(steps, f"{kind}, only {' '.join(options.only)}" if options.only else kind)
        for path in run.write(former, results_dir() / "bench"):
            print(f"bench: {path}")
    _print(former)
    if interrupted:
        return 130
    if options.docs:
        document(former, past, ROOT / "docs")
    return 0 if former.steps and all(step.good for step in former.steps) else 1


def _measured(steps: Sequence[Step], kind: str) -> tuple[Run, bool]:
    """The run, and whether it was interrupted; what had been measured until then is in it."""
    made = Run(commit=_commit(), when=clock.wall(), kind=kind, yardstick=[], steps=[])
    yard, results = made.yardstick, made.steps
    try:
        print("bench: the computer's own yardstick", flush=True)
        yard += [Row.of(line) for line in yardstick.lines()]
        for number, step in enumerate(steps, start=1):
            passed_s = clock.wall() - made.when
            print(f"bench: {passed_s:5.0f} s, step {number} of {len(steps)}: {step.title}", flush=True)
            results.append(carry_out(step))
            if results[-1].failure:
                print(f"bench: {step.title} failed: {results[-1].failure}", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        print("bench: interrupted", file=sys.stderr)
        return made.model_copy(update={"kind": f"{kind}, interrupted after {len(results)} of {len(steps)} parts"}), True
    return made, False


def _print(made: Run) -> None:
    """The table for the terminal."""
    for step in made.steps:
        print(f"\n{step.title}, {step.seconds:.0f} s")
        print(f"failed: {step.failure}" if step.failure else table([row.line for row in step.rows]))
    print("\nyardstick")
    print(table([row.line for row in made.yardstick]))
    missed = sum(row.line.met is False for step in made.steps for row in step.rows)
    failed = sum(bool(step.failure) for step in made.steps)
    unmeasured = sum(step.unmeasured for step in made.steps)
    told = f"{missed} bars are missed, {unmeasured} figures could not be measured"
    print(f"\nall in all: {told}, {failed} of {len(made.steps)} parts failed")


def _commit() -> str:
    """The commit of the sources, ``+`` where they have been changed since."""
    told = [
        subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)
        for arguments in (("rev-parse", "--short=8", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
    ]
    if told[0].returncode:
        return "unknown"
    return told[0].stdout.strip() + ("+" if told[1].stdout.strip() else "")


def _told(steps: Sequence[Step]) -> str:
    return "\n".join(f"  {step.title}" for step in steps)


if __name__ == "__main__":
    sys.exit(main())
