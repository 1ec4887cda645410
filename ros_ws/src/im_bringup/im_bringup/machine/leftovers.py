"""Leftovers of a killed machine: processes, shared memory, semaphores."""

import os
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

from im_bringup.machine.members import is_member, signal_member
from im_core import clock, names
from im_core.errors import LinkError
from im_core.ownership import require_own
from im_core.patience import Patience
from im_core.processes.procfs import ProcessId
from im_core.shm_names import left, remove_all

# a killed process goes when it gets a processor: on a busy computer that takes its time
_DYING_S = 10.0
_POLL_S = 0.02


def processes() -> list[ProcessId]:
    """Return the processes of the machine of the current ROS domain, without the calling one."""
    pids = (int(folder.name) for folder in Path("/proc").iterdir() if folder.name.isdigit())
    return [process for pid in pids if pid != os.getpid() and is_member(process := ProcessId.of(pid))]


def kill(found: list[ProcessId], timeout_s: float) -> list[ProcessId]:
    """Kill processes of the machine.

    Args:
        found: The processes; one that is not of the machine is left alone.
        timeout_s: Longest wait for their end [s].

    Returns:
        Those that are still there.
    """
    for process in found:
        signal_member(process, signal.SIGKILL)
    deadline = clock.monotonic() + timeout_s
    while any(process.alive() for process in found) and clock.monotonic() < deadline:
        clock.sleep(0.01)
    return [process for process in found if process.alive()]


def await_end(patience_s: float, goes_on: Callable[[], bool] = lambda: True) -> None:
    """Wait until the machine has no process any more, or ``goes_on`` returns False.

    Args:
        patience_s: Longest wait, as :class:`im_core.patience.Patience` counts [s].
        goes_on: Whether it is still waited for.
    """
    found = processes()
    patience = Patience(process.pid for process in found)
    while any(process.alive() for process in found) and goes_on() and patience.look() < patience_s:
        clock.sleep(_POLL_S)


def end_all() -> tuple[list[ProcessId], list[ProcessId]]:
    """Kill the processes of the machine, and the processes started meanwhile, as a supervisor does.

    Returns:
        Those that were there, and those that still are.
    """
    found: list[ProcessId] = []
    while more := [process for process in processes() if process not in found]:
        kill(more, _DYING_S)
        found += more
    return found, [process for process in found if process.alive()]


def remove_shared_memory() -> list[str]:
    """Remove the blocks and semaphores of the machine.

    Returns:
        Names of the files removed from ``/dev/shm``.
    """
    return remove_all(f"{names.instance()}_")


def of_others() -> list[Path]:
    """List files left in shared memory under names of the ROS domain after the user's cleanup."""
    return left(f"{names.instance()}_")


def foreign_sentence(others: Sequence[Path]) -> str:
    """Return a sentence on files in shared memory: the owning user, or the impossible removal, as of a folder."""
    try:
        require_own(others[0])
    except LinkError as error:
        more = f" ({len(others) - 1} more files are left, too)" if len(others) > 1 else ""
        return f"{error.message}{more}; scripts/stop.sh of that user stops a machine of that user"
    return f"{others[0]} cannot be removed; no machine has left it there: remove it, or set another ROS_DOMAIN_ID"
