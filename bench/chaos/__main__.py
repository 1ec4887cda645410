"""``chaos``: injects faults into the running machine and judges what it does about them."""

import argparse
import itertools
import statistics
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import yaml

from bench.chaos import machine, trial
from bench.chaos.command import Command
from bench.chaos.faults import KINDS, ROLES
from bench.chaos.safety import Watch
from bench.chaos.trial import Result, Setting, Verdict
from im_bringup.machine.interrupts import interrupt_once
from im_core import clock
from im_core.config import package_file
from im_core.errors import ImError, StateError

#: The first poses of the cell, without those at which an arm that was interrupted elsewhere may hide the light.
POSES, HIDING = 18, ("p09", "p10")
DEFAULT_INJECTIONS = 20


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="chaos",
        description="Start the machine, run commands, inject faults at moments drawn from a seed, and judge: did the "
        "command end true, did the next one succeed, was nothing left behind.",
        epilog="Exit codes: 0 no failure, 1 failures (the table says which; --seed N --injections 1 repeats one), "
        "2 bad usage, 130 interrupted.",
    )
    parser.add_argument("--minutes", type=float, help="how long to go on")
    parser.add_argument("--injections", type=int, help="how many (default: 20, or what --minutes gives)")
    parser.add_argument("--seed", type=int, default=1, help="of the first injection; the next has one more")
    parser.add_argument("--factor", type=float, default=0.0, help="clock factor of the machine (default: 0)")
    parser.add_argument("--kinds", nargs="+", choices=tuple(KINDS), default=tuple(KINDS), metavar="KIND")
    parser.add_argument("--roles", nargs="+", choices=ROLES, default=ROLES, metavar="ROLE")
    parser.add_argument("--port", type=int, default=8080, help="of the display")
    arguments = parser.parse_args()
    interrupt_once()
    results: list[Result] = []
    try:
        with tempfile.TemporaryDirectory() as folder:
            poses, seeds = _few_poses(Path(folder)), _seeds(arguments)
            while not results or results[-1].verdict is Verdict.LOST:
                with machine.running(arguments.factor, 1, arguments.port):
                    setting = _setting(poses, tuple(arguments.kinds), tuple(arguments.roles))
                    with Watch() as watch:
                        lost = _inject(seeds, setting, watch, results)
                    if not lost:
                        break
    except KeyboardInterrupt:
        print("chaos: interrupted", file=sys.stderr)
        return 130
    except ImError as error:
        print(f"chaos: {error.message}", file=sys.stderr)
        return 1
    finally:
        print(table(results))
    return 1 if any(result.verdict.failure for result in results) else 0


def _seeds(arguments: argparse.Namespace) -> Iterator[int]:
    """Seeds of the injections, until there are enough or time is up."""
    end = clock.monotonic() + 60.0 * arguments.minutes if arguments.minutes else float("inf")
    most = arguments.injections or (None if arguments.minutes else DEFAULT_INJECTIONS)
    for count in itertools.count():
        if clock.monotonic() > end or count == most:
            return
        yield arguments.seed + count


def _inject(seeds: Iterator[int], setting: Setting, watch: Watch, results: list[Result]) -> bool:
    """Inject until the seeds are used up, or the machine does not recover and is to be started anew: then true."""
    for seed in seeds:
        result = trial.run(seed, setting, watch)
        results.append(result)
        recovery = "" if result.recovery_s is None else f", recovered in {result.recovery_s:.1f} s"
        print(f"{seed}: {result.fault}: {result.verdict.value}{recovery}: {result.said}", flush=True)
        if result.verdict is Verdict.LOST:
            return True
    return False


def _few_poses(folder: Path) -> Path:
    """Some poses of the cell's own file, in a file of their own."""
    content = yaml.safe_load(package_file("im_dispatcher", "poses/ceiling_40.yaml").read_text(encoding="utf-8"))
    content["poses"] = [pose for pose in content["poses"][:POSES] if pose["name"] not in HIDING]
    path = folder / "few.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def _setting(poses: Path, kinds: tuple[str, ...], among: tuple[str, ...]) -> Setting:
    """Run one command undisturbed, to know what is normal.

    Raises:
        StateError: It fails.
    """
    command = Command(poses)
    outcome = command.outcome(trial.HANG_S)
    if not outcome.success:
        raise StateError(f"undisturbed, calibrate_camera failed: {outcome.said}")
    duration_s = outcome.ended - command.began
    return Setting(poses, command.steps, duration_s, kinds, among, frozenset(machine.shared_files()))


def table(results: Sequence[Result]) -> str:
    """Faults against outcomes, and the times of recovery."""
    rows = sorted({str(result.fault) for result in results})
    verdicts = [verdict for verdict in Verdict if any(result.verdict is verdict for result in results)]
    head = f"{'fault':44}" + "".join(f"{verdict.value:>14}" for verdict in verdicts) + f"{'recovery [s]':>14}"
    lines = [head]
    for row in rows:
        mine = [result for result in results if str(result.fault) == row]
        counts = Counter(result.verdict for result in mine)
        times = [result.recovery_s for result in mine if result.recovery_s is not None]
        cells = "".join(f"{counts[verdict] or '':>14}" for verdict in verdicts)
        lines.append(f"{row:44}{cells}{f'{max(times):.1f}' if times else '-':>14}")
    times = sorted(result.recovery_s for result in results if result.recovery_s is not None)
    if times:
        within = sum(seconds <= 15.0 for seconds in times) / len(results)
        lines.append(
            f"{len(results)} injections; recovery: median {statistics.median(times):.1f} s, "
            f"most {times[-1]:.1f} s, {within:.0%} within 15 s"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
