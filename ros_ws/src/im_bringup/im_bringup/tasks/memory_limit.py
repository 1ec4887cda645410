"""Memory limit of a process of the machine: a process with endless growth dies and is started again.

A packet of 52 bytes makes Fast DDS allocate all the memory of a computer (docs/security.md). Without a limit the whole
computer stands still; with one the process ends, mostly by an exception of C++ that nothing catches.
"""

import resource
import signal
from contextlib import suppress
from pathlib import Path

from im_core.processes.process import end_of_log
from im_core.processes.procfs import private_bytes

DEFAULT_MIB = 2048
"""Four times the most that a process of the default deployment was seen to have."""

#: The share of its limit at which a process is ended: where it survives each refusal, it does nothing else any more.
_FULL = 0.95
#: What a program of C++ or Python writes when it ends because it was refused memory.
_REFUSALS = ("bad_alloc", "out_of_memory", "MemoryError")
#: How much of a log may follow it: the stacks of all threads [bytes].
_STACKS = 1 << 18


def limit_memory(mib: int, pid: int = 0) -> None:
    """Limit the memory of a process, and of each process started later by the process.

    What counts is memory that is private and may be written (RLIMIT_DATA): neither shared memory, nor addresses that
    libraries reserve in advance, which are many times what they use and would count for RLIMIT_AS.

    Args:
        mib: The limit [MiB]; a lower one of the user stays.
        pid: The process; 0: this one. Nothing happens if it has ended.
    """
    with suppress(ProcessLookupError):
        most = resource.prlimit(pid, resource.RLIMIT_DATA)[1]
        limit = mib << 20 if most == resource.RLIM_INFINITY else min(mib << 20, most)
        resource.prlimit(pid, resource.RLIMIT_DATA, (limit, most))


def excess(pid: int, mib: int) -> str:
    """Return the reason to end a process, as a clause; empty if enough memory is left.

    Args:
        pid: The process.
        mib: Its limit [MiB].
    """
    taken_mib = private_bytes(pid) / 2**20
    return f"it has taken {taken_mib:.0f} MiB of memory, and its limit is {mib} MiB" if taken_mib > _FULL * mib else ""


def refused(code: int, log: Path, begin: int) -> bool:
    """Return whether a process ended after a refused memory allocation.

    Args:
        code: Its exit code, negative for a signal.
        log: What it wrote.
        begin: Where in the log its first line is [bytes].
    """
    return code in (1, -signal.SIGABRT) and any(word in end_of_log(log, begin, _STACKS) for word in _REFUSALS)
