"""The machine under test: who its processes are, what it leaves behind, how it is started and stopped."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from im_bringup.machine import leftovers, stop
from im_bringup.machine.start import start
from im_bringup.tasks import deployment as deployments
from im_core import clock, names
from im_core.errors import StateError
from im_core.processes.procfs import ProcessId

START_S = 400.0
APPEARANCE_S = 60.0
#: Processes that tasks start, by the module they run.
BOOTSTRAP = "bootstrap"
CHILDREN = {"im_mcs.servo": "servo", "im_sim.physics": "physics", "im_sim.cameras": "cameras"}
_POLL_S = 0.05


@contextmanager
def running(factor: float, seed: int, port: int, file: Path | None = None) -> Iterator[None]:
    """A machine of this ROS domain, stopped at the end; arguments as of :func:`begin`.

    Raises:
        StateError: It does not start.
    """
    begin(factor, seed, port, fresh=True, file=file)
    try:
        yield
    finally:
        stop.stop(say=lambda _: None)


def begin(factor: float, seed: int, port: int, fresh: bool, file: Path | None = None) -> None:
    """Start a machine of this ROS domain.

    Args:
        factor: Clock factor.
        seed: Of the testbed.
        port: Of the display.
        fresh: Whether it does not go on at once with what the one before had not ended.
        file: Its deployment; None: the default.

    Raises:
        StateError: It does not start.
    """
    path = file or deployments.default_path()
    deployment = deployments.load(path).with_values(clock_factor=factor, seed=seed, port=port)
    try:
        code = start(deployment, path, START_S, fresh, resume=not fresh)
    except KeyboardInterrupt:
        stop.stop(say=lambda _: None)
        raise
    if code != 0:
        raise StateError("the machine did not start")


def die_starting(factor: float, seed: int, port: int, seconds: float, file: Path | None = None) -> None:
    """Begin to start a machine that takes up what the one before had not ended, and kill all of it.

    Args:
        factor: Clock factor.
        seed: Of the testbed.
        port: Of the display.
        seconds: After how long [s].
        file: Its deployment; None: the default.
    """
    given = [*((str(file),) if file else ()), "--factor", str(factor), "--seed", str(seed), "--port", str(port)]
    argv = [sys.executable, "-m", "im_bringup.machine.start", *given]
    process = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    clock.sleep(seconds)
    process.kill()
    process.wait()
    leftovers.end_all()


def roles() -> dict[str, list[ProcessId]]:
    """Processes of the machine by what they are: tasks by name, ``servo``, ``physics``, ``cameras``, ``bootstrap``."""
    found: dict[str, list[ProcessId]] = {}
    for process in leftovers.processes():
        for role in _roles(process.pid):
            found.setdefault(role, []).append(process)
    return found


def sharing(role: str) -> set[str]:
    """Roles of the process of a role: tasks that share one die together."""
    return {role}.union(*(among for process in leftovers.processes() if role in (among := _roles(process.pid))))


def await_role(role: str, timeout_s: float) -> ProcessId | None:
    """The process of a role; None if there is none in time, as after a death from which nothing recovers."""
    deadline = clock.monotonic() + timeout_s
    while clock.monotonic() < deadline:
        if role in (present := roles()):
            return present[role][0]
        clock.sleep(_POLL_S)
    return None


def pid_of(role: str) -> int:
    """Process of a role, waited for where it is being started.

    Raises:
        StateError: There is none.
    """
    process = await_role(role, APPEARANCE_S)
    if process is None:
        raise StateError(f"there is no {role}")
    return process.pid


def send(number: signal.Signals, pids: Iterable[int]) -> None:
    """Send a signal to processes; one that has ended meanwhile, or was replaced, gets none."""
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def keep_logs(seed: int) -> Path:
    """Copy logs and journals of the machine, which do not stay as they are, into the results; where they are."""
    folder = names.results_dir() / f"chaos-{seed}-{clock.stamp_name()}"
    for part in ("log", "journal"):
        for found in names.run_dir().glob(f"**/{part}"):
            with suppress(shutil.Error):  # a file that has gone meanwhile
                shutil.copytree(found, folder / found.relative_to(names.run_dir()), dirs_exist_ok=True)
    return folder


def shared_files() -> set[str]:
    """Names of the machine's own blocks and semaphores in ``/dev/shm``."""
    return {name for name in os.listdir("/dev/shm") if name.removeprefix("sem.").startswith(f"{names.instance()}_")}


def journal_of(task: str) -> Path | None:
    """The newest file of a task's journal, None if it keeps none."""
    files = list((names.run_dir() / "journal" / task).glob("*.journal"))
    return max(files, key=lambda path: path.stat().st_mtime_ns, default=None)


def _roles(pid: int) -> list[str]:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
        process = Path(f"/proc/{pid}/fd/1").readlink().stem  # whoever has no module of its own has a log of its own
    except OSError:
        return []
    if "-m" in words:
        module = words[words.index("-m") + 1]
        return [CHILDREN[module]] if module in CHILDREN else []
    return [BOOTSTRAP] if process == BOOTSTRAP else _tasks().get(process, [])


@cache
def _tasks() -> dict[str, list[str]]:
    """Names of the tasks of each process."""
    deployment = deployments.load(deployments.default_path())
    placed = deployment.on_host(deployment.local_host())
    return {process: [each.name for each in tasks] for process, tasks in placed.items()}
