"""What a process of the real-time chain asks of the scheduler."""

import contextlib
import ctypes
import gc
import os
import socket

_PR_SET_TIMERSLACK = 29
#: Pages stay that were touched, now and later (MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT). Without the last one all of
#: every library becomes resident, and 32 MiB for each copy of OpenBLAS: 90 MiB in the servo alone.
_MCL_TOUCHED = 7
_FAVOURED_NICENESS = -5  # three times the share of an ordinary process
_CORE = "IM_SERVO_CORE"
_FIRST = "\0im/first"  # an abstract name: a host has it once, and it ends with its process
_place: list[socket.socket] = []  # holds it
_LIBC = ctypes.CDLL(None, use_errno=True)


def reserve() -> dict[str, str]:
    """What the environment of a paced machine's processes says, so that its servo meets its deadlines.

    Where SCHED_FIFO is not permitted, processes that :func:`prefer` have the highest core to themselves, and those that
    :func:`keep_off` leave it to them. Nothing where it is permitted, where there is one core only, or where whoever
    started this process has seen to it.
    """
    cores = os.sched_getaffinity(0)
    return {} if _CORE in os.environ or len(cores) == 1 or _fifo_permitted() else {_CORE: str(max(cores))}


def keep_off() -> None:
    """Leave the core that is reserved, if one is; holds for threads and processes that are started from now on."""
    if _CORE in os.environ:
        os.sched_setaffinity(0, os.sched_getaffinity(0) - {int(os.environ[_CORE])})


def prefer(priority: int, paced: bool, leader: int | None = None) -> bool:
    """Go before other processes: touched memory locked, garbage collector quiet, as much priority as is permitted.

    A paced process sleeps every tick and gets SCHED_FIFO; where it is not permitted, it goes to the core of
    :func:`reserve`. One that runs as fast as it goes has no deadline, but servo and physics wait for each other twice
    a tick, and in each of these waits would queue behind whatever else runs: a quarter of a command's time. They take
    one core between them, so those of the first machine on the host get SCHED_FIFO, if there is a core for the rest
    of the computer; two machines would starve it. Those of others get the larger share of whatever core they are on,
    where that is permitted. None is moved: much of each tick of one runs beside the other's.

    Args:
        priority: Of SCHED_FIFO, 1 to 99.
        paced: Whether the process sleeps until a deadline in every tick.
        leader: Process that sets the pace of one that is not paced, and gets SCHED_FIFO or does not; 0: one elsewhere.
            None: this one does.

    Returns:
        Whether SCHED_FIFO is in force.
    """
    gc.collect()
    gc.freeze()
    _LIBC.mlockall(_MCL_TOUCHED)
    _LIBC.prctl(_PR_SET_TIMERSLACK, 1)
    if not paced and not (_goes_first() if leader is None else _has_fifo(leader)):
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, _FAVOURED_NICENESS)
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        if _CORE in os.environ:
            os.sched_setaffinity(0, {int(os.environ[_CORE])})
        return False
    return True


def _goes_first() -> bool:
    """Whether there is a core beside this process's, and no other process of the host goes first."""
    if len(os.sched_getaffinity(0)) < 2:
        return False
    place = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        place.bind(_FIRST)
    except OSError:
        place.close()
        return False
    _place.append(place)
    return True


def _has_fifo(pid: int) -> bool:
    """Whether another process has SCHED_FIFO."""
    try:
        return pid > 0 and os.sched_getscheduler(pid) == os.SCHED_FIFO
    except ProcessLookupError:
        return False


def _fifo_permitted() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def release() -> None:
    """Let the garbage collector take everything again, so that libraries are torn down in order."""
    gc.unfreeze()
