"""What a process of the real-time chain asks of the scheduler."""

import ctypes
import gc
import os

_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_AND_FUTURE = 3
_FAVOURED_NICENESS = -15
_LIBC = ctypes.CDLL(None, use_errno=True)


def prefer(priority: int, paced: bool) -> bool:
    """Go before other processes: memory locked, garbage collector quiet, and as much priority as is permitted.

    A paced process sleeps every tick and gets SCHED_FIFO. One that runs as fast as it goes would starve the rest of
    the computer that way, as soon as two machines share it; it is only favoured by its niceness.

    Args:
        priority: SCHED_FIFO priority, 1 to 99.
        paced: Whether the process sleeps until a deadline in every tick.

    Returns:
        Whether SCHED_FIFO is in force.
    """
    gc.collect()
    gc.freeze()
    _LIBC.mlockall(_MCL_CURRENT_AND_FUTURE)
    _LIBC.prctl(_PR_SET_TIMERSLACK, 1)
    try:
        if paced:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        else:
            os.setpriority(os.PRIO_PROCESS, 0, _FAVOURED_NICENESS)
    except PermissionError:
        return False
    return paced


def release() -> None:
    """Let the garbage collector take everything again, so that libraries are torn down in order."""
    gc.unfreeze()
