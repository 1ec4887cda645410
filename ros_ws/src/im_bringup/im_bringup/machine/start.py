"""``start``: start the machine and wait until every task is ready, or say which is not, and why."""

import argparse
import os
import shutil
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from uuid import uuid4

from im_bringup.machine import leftovers, preflight, run_state, stop
from im_bringup.machine import machine_state as machine
from im_bringup.machine.interrupts import ignore_interrupts, interrupt_once, interrupts_held
from im_bringup.machine.machine_state import MachineRecord
from im_bringup.machine.start_mark import only_one
from im_bringup.tasks import deployment as deployments
from im_bringup.tasks import upkeep
from im_bringup.tasks.agent import MARKER, environment
from im_bringup.tasks.deployment import Deployment
from im_bringup.tasks.middleware import reach, require_addresses
from im_core import clock, config, names, unfinished_commands
from im_core.errors import ConfigError, ImError, NotFoundError, StateError, StoreError
from im_core.executables import INTERRUPTED, path_of
from im_core.files import read_text
from im_core.options import NumberParser, seconds, whole
from im_core.output import complain, say
from im_core.processes import host_record
from im_core.processes.process import ChildProcess
from im_core.processes.startup import START_TIMEOUT, START_TIMEOUT_S

#: Of ``--foxglove`` without a port, the usual one.
FOXGLOVE_PORT = 8765
#: What is in the user's folder is none of ours.
_SUPERVISOR = (sys.executable, "-P", "-m", "im_bringup.machine.supervisor")
_POLL_S = 0.05
#: How often a machine in the foreground is looked at, besides its end [s].
_LOOK_S = 1.0
#: What the parts of a start are: this host's and what is left of a machine before, and those of the bootstrap.
_PARTS = {
    "preflight": "preflight",
    "bootstrap": "bootstrap",
    "load": "processes and discovery",
    "configure": "configuration",
    "nets": "verification of nets",
    "start": "first service",
}


def parser() -> argparse.ArgumentParser:
    """The arguments of the command."""
    parser = NumberParser(
        prog="start",
        description="Start the machine of this ROS domain; return when every task is ready, or with --foreground when "
        "it has ended.",
        epilog="Exit codes: 0 ready, or with --foreground stopped; 1 not started (said why), or ended by itself; "
        "2 bad usage, deployment file or calibration; 130 interrupted before it was ready.",
    )
    parser.add_argument("deployment", nargs="?", help="deployment file (default: the one of im_bringup)")
    parser.add_argument("--factor", type=float, help="simulated seconds a second; 0: as fast as it goes")
    parser.add_argument("--period", type=float, help="period of servo and testbed [s], e.g. 0.001")
    parser.add_argument("--seed", type=int, help="seed of all random numbers")
    parser.add_argument(
        "--perfect-arm",
        action="store_true",
        default=None,
        help="let the simulated arms be as drawn (default: the tool is off by 0.3 to 1 mm)",
    )
    parser.add_argument("--port", type=int, help="TCP port of the display (a web page); the next free one if in use")
    parser.add_argument(
        "--control", action="store_true", default=None, help="let the page operate the machine (default: only show it)"
    )
    parser.add_argument(
        "--unproved",
        action="store_true",
        default=None,
        help="start even if the verification of the nets ends without a verdict; refused nets never start",
    )
    parser.add_argument(
        "--calibration",
        metavar="FOLDER",
        type=_folder,
        help="start with the calibrations in this folder: results of calibrate_camera, or what /vss kept in "
        "results/vss (default: cameras and laser scanner as drawn)",
    )
    parser.add_argument(
        "--cell",
        metavar="FILE",
        type=_cell,
        help="robot, cameras, lights and scenery, for all tasks: a file, or the name of a shipped cell, such as ur5 "
        "(default: the deployment's, else puma_pair)",
    )
    parser.add_argument(
        "--foxglove",
        nargs="?",
        type=whole,
        const=FOXGLOVE_PORT,
        metavar="PORT",
        help="let Foxglove connect, to ws://localhost:%(const)s or another port; it only looks (default: no bridge)",
    )
    parser.add_argument(
        "--host",
        metavar="NAME",
        help="run the tasks of another host of the deployment file instead, as the host's agent, until the machine "
        "ends; options of the machine are those of its start on the first host",
    )
    parser.add_argument(
        "--foreground", action="store_true", help="stay until the machine ends; Ctrl-C stops it (default: return)"
    )
    unfinished = parser.add_mutually_exclusive_group()
    unfinished.add_argument(
        "--resume",
        action="store_true",
        help="resume all unfinished commands at once, paused ones too, but not after an emergency stop (default: they "
        "come back paused; im run --resume NUMBER resumes one)",
    )
    unfinished.add_argument(
        "--fresh",
        action="store_true",
        help="begin a new mission even if the last one died or left unfinished commands; the last one is kept in "
        ".run/im<domain>/missions",
    )
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=os.environ.get(START_TIMEOUT) or f"{START_TIMEOUT_S:g}",
        help="longest wait of the command, and of the machine's parts for each other [s] (default: %(default)s, or the "
        f"environment variable {START_TIMEOUT})",
    )
    return parser


def main() -> int:
    """Run the command."""
    arguments = parser().parse_args()
    if arguments.host is not None:
        become_agent(arguments)
    interrupt_once()
    path = Path(arguments.deployment or deployments.default_path()).resolve()
    failure = 2
    try:
        whole = deployments.load(path)
        deployment = deployments.with_options(whole, arguments)
        check_programs(deployment, path)
        require_addresses(deployment, path)
        check_cell(deployment, arguments.cell, whole)
        deployments.require_calibration_here(deployment, arguments.calibration)
        check_calibration(deployment, path)
        failure = 1
        with only_one() as mark:
            stay = bool(arguments.foreground)
            # an interrupt after the machine is ready is ignored: the exit code says that it runs. In the foreground it
            # stops the machine, and who comes to stop it meets no start any more
            asked = mark.stop_asked, mark.close if stay else ignore_interrupts
            return start(deployment, path, arguments.timeout, arguments.fresh, arguments.resume, *asked, stay)
    except KeyboardInterrupt:
        complain("\nstart: interrupted")
        return INTERRUPTED
    except ImError as error:
        complain(f"start: {error.message}")
        return failure


def become_agent(arguments: argparse.Namespace) -> None:
    """Replace the program by the agent of a host.

    Args:
        arguments: Of the command line; exits with a sentence if an option is for the first host.
    """
    usual = parser().parse_args([])
    kept = ("host", "deployment", "timeout")
    for name, value in vars(arguments).items():
        if name not in kept and value != getattr(usual, name):
            parser().error(f"--{name} is given at the start on the first host; --host takes it from there")
    path = Path(arguments.deployment or deployments.default_path()).resolve()
    failure = 2
    try:
        check_host(arguments.host, deployments.load(path), path)
        failure = 1
        require_none_runs()
        preflight.check_host()
    except ImError as error:
        complain(f"start: {error.message}")
        sys.exit(failure)
    agent = [str(path_of("im_bringup", "agent")), arguments.host, str(path)]
    argv = [*_SUPERVISOR, "--agent", *agent]
    os.execve(sys.executable, argv, {**os.environ, MARKER: names.instance()})


def check_host(host: str, deployment: Deployment, path: Path) -> None:
    """Refuse a host that a deployment does not have.

    Raises:
        ConfigError: It has not; names the file and the known hosts.
    """
    try:
        deployment.on_host(host)
    except NotFoundError as error:
        raise config.fault_in(path, ("hosts",), error.message) from error


def check_programs(deployment: Deployment, path: Path) -> None:
    """Check a deployment for the local host, and the local host for the executables of all local tasks.

    Raises:
        ConfigError: It is not, or has not.
    """
    host = deployment.local_host()
    where: tuple[str, ...] = ("hosts",)
    try:
        for process, placed in deployment.on_host(host).items():
            for each in placed:
                where = ("hosts", host, process, each.name)
                path_of(each.task.package, each.task.executable)
    except NotFoundError as error:
        raise config.fault_in(path, where, error.message) from error


def check_cell(deployment: Deployment, given: str | None, whole: Deployment | None = None) -> None:
    """Read the cell of a deployment, if it names one, and say which tasks it has no use for.

    Args:
        deployment: What is to be started.
        given: The file on the command line; None: none.
        whole: The deployment with all tasks; None: nothing is left out.

    Raises:
        ConfigError: It is missing or wrong, or other hosts do not know of it.
    """
    if given is not None and len(deployment.hosts) > 1:
        raise ConfigError("--cell is for one host; with several write `cell: FILE` into the deployment file of each")
    if deployment.cell:
        parts = deployments.load_parts(deployment.cell)
        for task, lacking in deployments.left_out(whole or deployment, parts).items():
            say(f"start: task {task} is left out: the cell {deployment.cell} has no {' and no '.join(lacking)}")


def check_calibration(deployment: Deployment, path: Path) -> None:
    """Read the calibrations for tasks of the local host, if there are any, and print a summary.

    Raises:
        ConfigError: They are missing or wrong, or no task takes them, or one of a host that knows the file only.
    """
    if not deployment.calibration:
        return
    # they take half a second, which few starts need
    from im_cell.calibration_files import read_calibration
    from im_cell.robot import load_cell

    takers = [placed for placed in deployment.tasks() if placed.task.takes("calibration")]
    if not takers:
        raise ConfigError(f"calibration: {deployment.calibration}: no task has '${{calibration}}' among its parameters")
    for taker in takers:
        if taker.host == deployment.local_host():
            cell = load_cell(deployment.cell or None)
            files = read_calibration(Path(deployment.calibration), cell)
            say(f"start: {taker.name} starts with {files.folder}: {files.summary()}")
        elif deployment.calibration != deployments.load(path).calibration:
            raise ConfigError(
                f"calibration: {deployment.calibration}: {taker.name} is on host {taker.host}, which reads {path}; "
                "write the folder there"
            )


def start(
    deployment: Deployment,
    path: Path,
    timeout_s: float,
    fresh: bool = True,
    resume: bool = False,
    stop_asked: Callable[[], bool] = lambda: False,
    at_ready: Callable[[], None] = lambda: None,
    foreground: bool = False,
) -> int:
    """Start the machine.

    Args:
        deployment: What to start.
        path: The file it came from.
        timeout_s: Longest wait for all tasks to be ready [s].
        fresh: Begin a new mission whatever became of the one before.
        resume: Go on at once with commands that had not ended; otherwise they come back paused.
        stop_asked: Whether the machine is to be stopped, though it is not yet ready.
        at_ready: Called when the machine is ready, before anything is said of it.
        foreground: Stay until the machine ends; it ends with this process.

    Returns:
        0 if all tasks are ready, else 1, or 130 if it was interrupted; the machine is down again then. In the
        foreground as of :func:`attend`; an interrupt stops the machine in order.

    Raises:
        StateError: A machine of this ROS domain runs already, or it was stopped while it started.
        ImError: This host has not what the machine needs; nothing was started.
        KeyboardInterrupt: It was interrupted before it began to clear the way; nothing was touched.
    """
    began = clock.monotonic()
    require_none_runs()
    preflight.check_host()
    several = len(deployment.hosts) > 1  # their journals would have to be of the same mission
    ready: MachineRecord | None = None
    try:
        goes_on = clear_the_way(fresh or several)
        tidy(deployment)
        if said := reach(os.environ, deployment):
            say(f"start: {said}")
        took = {"preflight": clock.monotonic() - began}
        with interrupts_held():  # a process that is just forked has no mark yet by which it would be found and ended
            process = spawn_bootstrap(deployment, path, timeout_s, resume, signal.SIGTERM if foreground else None)
        try:
            ready = await_ready(process, began, timeout_s, took, goes_on, stop_asked)
            if ready is None:
                return 1
            at_ready()
            print_ready(ready, clock.monotonic() - began)
            print_parts({**took, **ready.took})
            if goes_on:
                print_unfinished(resume)
            return attend(process) if foreground else 0
        except ImError:
            stop.stop(say=lambda _: None)
            raise
    except KeyboardInterrupt:
        if ready is not None and foreground:
            complain("\nstart: interrupted; stopping the machine")
            return stop.stop(say)
        complain("\nstart: interrupted; stopping what was started")
        stop.stop(say=lambda _: None)
        return INTERRUPTED


def await_ready(
    process: ChildProcess,
    began: float,
    timeout_s: float,
    took: dict[str, float],
    goes_on: bool,
    stop_asked: Callable[[], bool] = lambda: False,
) -> MachineRecord | None:
    """Wait until all tasks are ready, and print the events meanwhile.

    Args:
        process: The bootstrap's supervisor.
        began: When the start has begun [s].
        timeout_s: Longest wait since then [s].
        took: How long its parts before have taken [s].
        goes_on: Whether a mission goes on.
        stop_asked: Whether the machine is to be stopped.

    Returns:
        The machine whose tasks are all ready; None: it is down again.

    Raises:
        StateError: The machine was stopped.
        ImError: What the bootstrap tells cannot be read.
    """
    shown = ""
    while clock.monotonic() - began < timeout_s:
        record = machine.read()
        if process.poll() == 0 or stop_asked():
            raise StateError("the machine was stopped while it started")
        if process.poll() is not None:
            complain(f"start: the bootstrap has ended: {stop.bootstrap_words()}")
            stop.stop(say=lambda _: None)
            return None
        if record is not None:
            verifies = record.phase == "CONFIGURE" and "configure" in record.took
            step = "verify the nets together" if verifies else f"{record.phase.lower()} {record.tasks} tasks"
            if step != shown:
                took.setdefault("bootstrap", clock.monotonic() - began - took["preflight"])
                shown = step
                say(f"start: {shown}")
            if record.state == machine.READY:
                return record
            if record.state == machine.FAILED:
                why = "its nets may not run together" if record.refused else "not every task could be started"
                give_up(why, record, goes_on)
                return None
        clock.sleep(_POLL_S)
    give_up(f"not every task was ready after {timeout_s:g} s (--timeout allows more)", machine.read(), goes_on)
    return None


def attend(process: ChildProcess) -> int:
    """Wait for the end of the machine.

    Args:
        process: The bootstrap's supervisor.

    Returns:
        0 if it was stopped, 1 if it ended by itself or something of it could not be ended.
    """
    while process.poll() is None:
        process.await_end(_LOOK_S)
    if process.poll() == 0:
        say("start: the machine was stopped")
        return 0
    complain(f"start: the machine has ended: {stop.bootstrap_words()}")
    stop.stop(say=lambda _: None)
    return 1


def require_none_runs() -> None:
    """Check the absence of a running machine in the current ROS domain, and in another domain with the same folder.

    The agent of a host of a machine counts as a machine.

    Two with one folder would go on with each other's commands, and write into each other's journals.

    Raises:
        StateError: One does.
    """
    record = machine.read()
    if record is not None and record.alive:
        raise StateError(
            f"a machine of ROS domain {machine.domain()} runs already ({record.state}, process {record.pid}); "
            "stop it with scripts/stop.sh, or set another ROS_DOMAIN_ID"
        )
    if (agent := host_record.read()) is not None and agent.is_agent:
        raise StateError(
            f"the agent of host {agent.host} of ROS domain {machine.domain()} runs here already (process {agent.pid}); "
            "stop it with scripts/stop.sh, or set another ROS_DOMAIN_ID"
        )
    if other := machine.neighbour(names.run_dir()):
        raise StateError(
            f"the machine {other} runs with the folder {names.run_dir()}, where its journals are; "
            "set another IM_RUN_DIR, or unset it and ROS_LOG_DIR"
        )


def clear_the_way(fresh: bool) -> bool:
    """Remove the leftovers of a machine of the current ROS domain, except a mission to be continued.

    Args:
        fresh: Begin a new mission whatever became of the one before.

    Returns:
        Whether one goes on.

    Raises:
        ImError: The folder of its logs cannot be written, what its mission has left not be moved, or what is in shared
            memory is another user's.
    """
    leftovers.end_all()
    leftovers.remove_shared_memory()
    if others := leftovers.of_others():
        raise StateError(leftovers.foreign_sentence(others))
    run_dir = names.run_dir()
    goes_on = run_state.prepare(run_dir, fresh, lambda sentence: say(f"start: {sentence}"))
    try:
        names.display_file().unlink(missing_ok=True)
    except OSError as error:
        raise StoreError.of("removed", names.display_file(), error) from error
    for folder in ("log", "parameters"):
        shutil.rmtree(run_dir / folder, ignore_errors=True)
        preflight.check_folder(run_dir / folder)  # another user's is still there
    if (run_dir / names.ESTOP).exists():
        say("start: an emergency stop is kept from before: arms get no power until scripts/im recover resets it")
    return goes_on


def tidy(deployment: Deployment) -> None:
    """Remove surplus and outdated results, and print the limits for kept ones."""
    results, keep = names.results_dir(), deployment.keep
    spared = [Path(deployment.calibration)] if deployment.calibration else []
    removed = upkeep.prune(results, keep, spared, clock.wall())
    upkeep.prune_tool_logs(names.run_dir() / "ros")
    gone = f"; {len(removed)} were removed" if removed else ""
    say(f"start: {keep.sentence(results)}{gone}")


def spawn_bootstrap(
    deployment: Deployment, path: Path, timeout_s: float, resume: bool, death_signal: signal.Signals | None = None
) -> ChildProcess:
    """Start the bootstrap under a supervisor, detached from the terminal; all get the time limit of a start [s].

    All know which run this is, too, also those that are started again in it: a task whose journal is of another run
    pauses what comes back with it.
    """
    run_dir = names.run_dir().resolve()
    argv = [
        *_SUPERVISOR,
        str(path_of("im_bringup", "bootstrap")),
        str(path),
        deployments.options_text(deployment, deployments.HERE),
    ]
    return ChildProcess(
        argv,
        log=run_dir / "log" / "bootstrap.log",
        environment={
            **environment(os.environ, run_dir, deployment),
            START_TIMEOUT: repr(timeout_s),
            names.RUN: uuid4().hex,
            names.RESUMES: "1" if resume else "",
        },
        death_signal=death_signal,
    )


def _cell(text: str) -> str:
    return text if deployments.is_name(text) and not os.path.exists(text) else os.path.abspath(text)


def _folder(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("the name of a folder is needed")
    return str(Path(text).resolve())


def give_up(sentence: str, record: MachineRecord | None, goes_on: bool) -> None:
    """Print the failure and stop everything; if a continued mission failed, print also how to begin anew."""
    complain(f"start: {sentence}:")
    for missing in record.missing if record is not None else ["the bootstrap has not reported"]:
        complain(f"  {missing}")
    if goes_on:
        complain("start: scripts/start.sh --fresh begins a new mission and keeps the one before")
    stop.stop(say=lambda _: None)


def print_ready(record: MachineRecord, seconds: float) -> None:
    """Print the readiness of the machine, and hints for use."""
    speed = "as fast as it goes" if record.clock_factor == 0 else f"clock factor {record.clock_factor:g}"
    say(f"start: ready after {seconds:.1f} s: {record.tasks} tasks, ROS domain {machine.domain()}, {speed}")
    if record.nets:
        say(f"start: {record.nets}")
    shown = names.display_file()
    nets = f"nets at {read_text(shown).strip()}, " if shown.exists() else ""
    say(f"start: {nets}logs in {record.run_dir}/log")


def print_unfinished(resume: bool) -> None:
    """Print the present state of each unfinished command, and the ways to continue or end a paused one."""
    unfinished = unfinished_commands.noted(names.run_dir())
    goes_on = resume and not (names.run_dir() / names.ESTOP).exists()
    for command in unfinished:
        ways = f"scripts/im run --resume {command.number} goes on with it, --cancel {command.number} ends it"
        say(f"start: {command} {'goes on' if goes_on else f'had not ended and is paused: {ways}'}")
    if unfinished and not goes_on:
        say("start: nothing of them moves until then; at a start --resume goes on with all, --fresh sets them aside")


def print_parts(took: Mapping[str, float]) -> None:
    """Print the time of each part of the start, in order [s]."""
    say(f"start: {', '.join(f'{_PARTS[part]} {seconds:.1f} s' for part, seconds in took.items())}")


if __name__ == "__main__":
    sys.exit(main())
