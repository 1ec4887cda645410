"""``chaos``: injects faults into the running machine and judges what it does about them."""

import argparse
import itertools
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import yaml

from bench.chaos import demo, everything, machine, over_hosts, records, trial
from bench.chaos.command import Command
from bench.chaos.faults import JOURNALS, KINDS, ROLES
from bench.chaos.records import Result, Verdict
from bench.chaos.safety import Watch
from bench.chaos.trial import Setting
from bench.part import positive
from bench.power.plug import Plug
from im_bringup.machine.interrupts import interrupt_once
from im_bringup.tasks import deployment as deployments
from im_core import clock, names
from im_core.config import package_file
from im_core.errors import ImError, StateError
from im_pnt_node.journal.log import Sync

#: The first poses of the cell, without those at which an arm that was interrupted elsewhere may hide the light.
POSES, HIDING = 18, ("p09", "p10")
#: Of a machine over hosts: a command there takes several times as long.
POSES_OVER_HOSTS = 15
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
    parser.add_argument("--minutes", type=positive(float), help="how long to go on")
    parser.add_argument("--injections", type=positive(int), help="how many (default: 20, or what --minutes gives)")
    parser.add_argument(
        "--seed", type=int, help="of the first injection, the next has one more (default: 1, or what follows in --out)"
    )
    parser.add_argument("--factor", type=float, default=0.0, help="clock factor of the machine (default: 0)")
    kinds, roles = ", ".join(KINDS), ", ".join(ROLES)
    between = ", ".join(over_hosts.KINDS)
    parser.add_argument(
        "--kinds",
        nargs="+",
        choices=(*KINDS, *over_hosts.KINDS),
        metavar="KIND",
        help=f"only of {kinds}; with --hosts of {between}",
    )
    parser.add_argument(
        "--hosts",
        type=int,
        choices=tuple(over_hosts.DEPLOYMENTS)[1:],
        help="a machine over so many hosts, which are namespaces of this computer, and faults between these",
    )
    parser.add_argument(
        "--roles", nargs="+", choices=ROLES, default=ROLES, metavar="ROLE", help=f"done only to these: {roles}"
    )
    parser.add_argument(
        "--everything",
        action="store_true",
        help="kill -9 of all processes instead, and a start: does the command go on to what it finds undisturbed?",
    )
    parser.add_argument(
        "--power",
        choices=[sync.value for sync in Sync],
        help="with --everything: the power goes, too, and what was not synchronised; journals are kept with this "
        "journal_sync",
    )
    parser.add_argument(
        "--demo",
        action="store_true",
        help="signals to scripts/demo.sh instead, and the end of its terminal: is anything left behind?",
    )
    parser.add_argument("--port", type=int, default=8080, help="of the display")
    parser.add_argument("--out", type=Path, metavar="FILE", help="add a line for each injection; the table is of all")
    parser.add_argument("--docs", type=Path, metavar="PAGE", help="write the table of --out there, and inject nothing")
    arguments = parser.parse_args()
    known = tuple(over_hosts.KINDS if arguments.hosts else KINDS)
    arguments.kinds = arguments.kinds or known
    if wrong := [kind for kind in arguments.kinds if kind not in known]:
        here = "between hosts" if arguments.hosts else "on one host"
        parser.error(f"{wrong[0]} is no fault {here}; those are {', '.join(known)}")
    if arguments.power is not None and not arguments.everything:
        parser.error("--power takes everything down: --everything")
    if arguments.docs is not None and arguments.out is None:
        parser.error("--docs needs --out, the file that it sums up")
    interrupt_once()
    results: list[Result] = []
    try:
        if arguments.demo:
            return 1 if _demo(arguments) else 0
        if arguments.out is not None and arguments.out.exists():
            results = records.read(arguments.out)
        if arguments.docs is not None:
            records.document(results, arguments.docs)
        elif arguments.hosts:
            _run_over_hosts(arguments, results)
        else:
            _run(arguments, results)
    except KeyboardInterrupt:
        print("chaos: interrupted", file=sys.stderr)
        return 130
    except ImError as error:
        print(f"chaos: {error.message}", file=sys.stderr)
        return 1
    finally:
        if not arguments.demo:
            print(records.table(results))
    return 1 if any(result.verdict.failure for result in results) else 0


def _run(arguments: argparse.Namespace, results: list[Result]) -> None:
    """Inject until there are enough or time is up; what comes of it is added to ``results``.

    Raises:
        ImError: The machine does not start, or fails undisturbed.
    """
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        poses, seeds = _few_poses(Path(folder)), _seeds(arguments, results)
        file = _synchronising(Path(folder), arguments.power) if arguments.power else None
        plug = stack.enter_context(closing(Plug(names.run_dir()))) if arguments.power else None
        lost = True
        while lost:
            with machine.running(arguments.factor, 1, arguments.port, file):
                setting, undisturbed = _setting(poses, arguments)
                if arguments.everything:
                    again = partial(machine.begin, arguments.factor, 1, arguments.port, fresh=False, file=file)
                    dies = partial(machine.die_starting, arguments.factor, 1, arguments.port, file=file)
                    for seed in seeds:
                        _keep(everything.run(seed, setting, again, dies, undisturbed, plug), results, arguments.out)
                    return
                with Watch() as watch:
                    lost = _inject(seeds, setting, watch, results, arguments.out)


def _run_over_hosts(arguments: argparse.Namespace, results: list[Result]) -> None:
    """Inject faults between hosts as :func:`_run` does.

    Raises:
        ImError: The machine does not start, or fails undisturbed.
    """
    seeds = _seeds(arguments, results)
    with tempfile.TemporaryDirectory() as folder:
        poses = _few_poses(Path(folder), POSES_OVER_HOSTS)
        lost = True
        while lost:
            with over_hosts.running(arguments.hosts, arguments.factor, Path(folder)) as several:
                steps, duration_s, _ = _undisturbed(Command(poses, host=several.first))
                lost = False
                several.record()
                for seed in seeds:
                    result = over_hosts.run(seed, several, poses, steps, duration_s, tuple(arguments.kinds))
                    _keep(result, results, arguments.out)
                    if lost := result.verdict is Verdict.LOST:
                        break


def _demo(arguments: argparse.Namespace) -> int:
    """Send signals to demos until there are enough or time is up; return how many left something behind.

    Raises:
        ImError: A demo fails before a signal comes.
    """
    failures = 0
    with tempfile.TemporaryDirectory() as folder:
        poses = _few_poses(Path(folder))
        for seed in _seeds(arguments, []):
            trial = demo.DemoTrial.of(seed)
            end = demo.carry_out(trial, poses, arguments.port)
            failures += bool(end.left)
            print(f"{trial}: {end}", flush=True)
    return failures


def _synchronising(folder: Path, sync: str) -> Path:
    """The default deployment with another ``journal_sync``, in a file of its own."""
    content = yaml.safe_load(deployments.default_path().read_text(encoding="utf-8"))
    for processes in content["hosts"].values():
        for tasks in processes.values():
            for name in JOURNALS:
                if name in tasks:
                    tasks[name].setdefault("parameters", {})["journal_sync"] = sync
    path = folder / "synchronising.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")  # tasks are started in its order
    return path


def _seeds(arguments: argparse.Namespace, results: list[Result]) -> Iterator[int]:
    """Seeds of the injections, until there are enough or time is up."""
    first = arguments.seed
    if first is None:
        first = max((result.seed for result in results), default=0) + 1
    end = clock.monotonic() + 60.0 * arguments.minutes if arguments.minutes else float("inf")
    most = arguments.injections or (None if arguments.minutes else DEFAULT_INJECTIONS)
    for count in itertools.count():
        if clock.monotonic() > end or count == most:
            return
        yield first + count


def _inject(seeds: Iterator[int], setting: Setting, watch: Watch, results: list[Result], out: Path | None) -> bool:
    """Inject until the seeds are used up, or the machine does not recover and is to be started anew: then true."""
    for seed in seeds:
        result = trial.run(seed, setting, watch)
        _keep(result, results, out)
        if result.verdict is Verdict.LOST:
            return True
    return False


def _keep(result: Result, results: list[Result], out: Path | None) -> None:
    """Add what came of an injection to the results and the file, and tell it."""
    results.append(result)
    if out is not None:
        records.append(out, result)
    recovery = "" if result.recovery_s is None else f", recovered in {result.recovery_s:.1f} s"
    print(f"{result.seed}: {result.fault}: {result.verdict.value}{recovery}: {result.said}", flush=True)
    if result.verdict.failure:
        print(f"logs: {machine.keep_logs(result.seed)}", flush=True)


def _few_poses(folder: Path, most: int = POSES) -> Path:
    """Some poses of the cell's own file, in a file of their own."""
    content = yaml.safe_load(package_file("im_cell", "cells/puma_pair/ceiling_40.yaml").read_text(encoding="utf-8"))
    content["poses"] = [pose for pose in content["poses"][:most] if pose["name"] not in HIDING]
    path = folder / "few.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def _setting(poses: Path, arguments: argparse.Namespace) -> tuple[Setting, dict[str, object]]:
    """Run one command undisturbed, to know what is normal, and what it finds.

    Raises:
        StateError: It fails.
    """
    command = Command(poses)
    steps, duration_s, report = _undisturbed(command)
    setting = Setting(
        poses,
        steps,
        duration_s,
        arguments.factor,
        tuple(arguments.kinds),
        tuple(arguments.roles),
        frozenset(machine.shared_files()),
    )
    return setting, report


def _undisturbed(command: Command) -> tuple[int, float, dict[str, object]]:
    """Lines of progress of a command, how long it took [s], and what it found.

    Raises:
        StateError: It fails.
    """
    outcome = command.outcome(trial.HANG_S)
    if not outcome.success:
        raise StateError(f"undisturbed, calibrate_camera failed: {outcome.said}")
    return command.steps, outcome.ended - command.began, outcome.report


if __name__ == "__main__":
    sys.exit(main())
