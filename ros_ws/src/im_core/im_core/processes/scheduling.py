"""Scheduling requests of a process in the real-time chain."""

import contextlib
import ctypes
import gc
import os

_PR_SET_TIMERSLACK = 29
#: Pages stay that were touched, now and later (MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT). Without the last one all of
#: every library becomes resident, and 32 MiB for each copy of OpenBLAS: 90 MiB in the servo alone.
_MCL_TOUCHED = 7
_FAVOURED_NICENESS = -5  # three times the share of an ordinary process
_CORE = "IM_SERVO_CORE"
_LIBC = ctypes.CDLL(None, use_errno=True)


def reserve() -> dict[str, str]:
    """Return the environment for processes of a paced machine, to let the servo meet deadlines.

    Where SCHED_FIFO is not permitted, processes that :func:`prefer` have the highest core to themselves, and those that
    :func:`keep_off` leave it to them. Nothing where it is permitted, where there is one core only, or where whoever
    started this process has seen to it.
    """
    cores = os.sched_getaffinity(0)
    return {} if _CORE in os.environ or len(cores) == 1 or _fifo_permitted() else {_CORE: str(max(cores))}


def keep_off() -> None:
    """Leave the reserved core, if any; holds for threads and processes started from now on."""
    if _CORE in os.environ:
        os.sched_setaffinity(0, os.sched_getaffinity(0) - {int(os.environ[_CORE])})


def prefer(priority: int, paced: bool) -> bool:
    """Go before other processes: touched memory locked, garbage collector quiet, as much priority as is permitted.

    A paced process sleeps every tick and gets SCHED_FIFO; where it is not permitted, it goes to the core of
    :func:`reserve`. One that runs as fast as it goes would starve the rest of the computer that way, as soon as two
    machines share it, and it has no deadline: it gets the larger share of whatever core it is on, where that is
    permitted. Servo and physics are left on cores of their own: much of each tick of one runs beside the other's.

    Args:
        priority: Of SCHED_FIFO, 1 to 99.
        paced: Whether the process sleeps until a deadline in every tick.

    Returns:
        Whether SCHED_FIFO is in force.
    """
    gc.collect()
    gc.freeze()
    _LIBC.mlockall(_MCL_TOUCHED)
    _LIBC.prctl(_PR_SET_TIMERSLACK, 1)
    if not paced:
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


def _fifo_permitted() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def release() -> None:
    """Let the garbage collector take everything again, for an orderly teardown of libraries."""
    gc.unfreeze()
