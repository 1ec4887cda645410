"""Kernel data of running processes and threads in ``/proc``."""

import os
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

#: Longer than what is read here [bytes].
_LINE = 4096
_PAGE = os.sysconf("SC_PAGE_SIZE")
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
#: How ``/proc/self/maps`` tells of memory that is private, may be written, and is of no file.
_ANONYMOUS = ["rw-p", "00000000", "00:00", "0"]


class Scheduled(NamedTuple):
    """How a process or a thread was scheduled so far.

    Attributes:
        ran_s: Time on a processor [s].
        queued_s: Time in which it wanted a processor and had none [s].
    """

    ran_s: float
    queued_s: float


def stat_fields(pid: int) -> list[str] | None:
    """The fields of ``/proc/<pid>/stat`` from the third on, the state; None if there is no such process."""
    stat = _told(f"/proc/{pid}/stat")
    if stat is None:
        return None
    return stat[stat.rindex(")") + 2 :].split()  # the command name may hold blanks and parentheses


@dataclass(frozen=True)
class ProcessId:
    """Process of the host: the kernel reuses a pid, but not pid and start time together.

    Attributes:
        pid: Process id; 0 stands for "no process".
        start: Start time of the process since boot [clock ticks], field 22 of ``/proc/<pid>/stat``.
    """

    pid: int
    start: int

    @classmethod
    def of(cls, pid: int) -> "ProcessId":
        """Return the identity of a process running now; start is -1 without such a process."""
        return cls(pid, _start_of_running(pid))

    @classmethod
    def current(cls) -> "ProcessId":
        """Identity of the calling process."""
        return cls.of(os.getpid())

    def alive(self) -> bool:
        """Return whether the very same process still runs; a dead process not yet reaped does not."""
        return self.pid > 0 and _start_of_running(self.pid) == self.start

    def ended(self) -> bool:
        """Return whether the process ran when its identity was taken, and runs no more."""
        return self.start >= 0 and not self.alive()


def _start_of_running(pid: int) -> int:
    """Return the start time of a running process, -1 if missing or a zombie."""
    fields = stat_fields(pid)
    return -1 if fields is None or fields[0] in "ZX" else int(fields[19])


def processes_ending_in(bits: int, size: int) -> list[int]:
    """Return the pids of the running processes whose last ``size`` bits are ``bits``."""
    with open("/proc/sys/kernel/pid_max", encoding="ascii") as file:
        largest = int(file.read())
    return [pid for pid in range(bits, largest + 1, 1 << size) if _start_of_running(pid) >= 0]


def families(roots: Collection[int]) -> dict[int, list[int]]:
    """Return each of some processes together with its descendants that run now."""
    parents = {pid: int(fields[1]) for pid in map(int, filter(str.isdecimal, os.listdir("/proc")))
               if (fields := stat_fields(pid)) is not None}  # fmt: skip
    found: dict[int, list[int]] = {root: [root] for root in roots}
    for pid in parents:
        ancestor = pid
        while (ancestor := parents.get(ancestor, 0)) > 0:
            if ancestor in found:
                found[ancestor].append(pid)
                break
    return found


def cpu_of(pid: int) -> float:
    """Return the CPU time used by all threads of a process [s]; 0 without a process."""
    fields = stat_fields(pid)
    return 0.0 if fields is None else (int(fields[11]) + int(fields[12])) / _TICKS_PER_S


def has_loaded(pid: int, file: str) -> bool:
    """Return whether a process has mapped a file with a path that holds ``file``; not if this user may not know."""
    try:
        with open(f"/proc/{pid}/maps", encoding="utf-8", errors="replace") as maps:
            return any(file in line for line in maps)
    except OSError:
        return False


def scheduled(pid: int, thread: int | None = None) -> Scheduled | None:
    """Return the scheduling of a process's main thread, or of another thread; None if ended or not counted."""
    folder = f"/proc/{pid}" if thread is None else f"/proc/{pid}/task/{thread}"
    told = _told(f"{folder}/schedstat")
    if not told:
        return None
    ran, queued, _ = told.split()
    return Scheduled(int(ran) * 1e-9, int(queued) * 1e-9)


def threads_queued_s(pid: int) -> float:
    """Return the time all living threads of a process together have waited for a processor [s]."""
    return sum(found.queued_s for thread in threads_of(pid) if (found := scheduled(pid, thread)) is not None)


def threads_of(pid: int) -> list[int]:
    """The threads of a process; empty if there is none."""
    try:
        return [int(name) for name in os.listdir(f"/proc/{pid}/task")]
    except FileNotFoundError:
        return []


def thread_name(pid: int, thread: int) -> str:
    """Return the name of a thread; empty for an ended thread."""
    return (_told(f"/proc/{pid}/task/{thread}/comm") or "").rstrip()


def waits_of(pid: int, thread: int) -> tuple[int, float] | None:
    """Return a thread's number of voluntary waits, and the time on a processor [s]; None for an ended thread."""
    status, found = _told(f"/proc/{pid}/task/{thread}/status"), scheduled(pid, thread)
    if not status or found is None:
        return None
    return int(status.partition("\nvoluntary_ctxt_switches:")[2].split()[0]), found.ran_s


def private_bytes(pid: int) -> int:
    """Return the private writable memory of a process, as counted by RLIMIT_DATA [bytes]; 0 if there is none."""
    told = _told(f"/proc/{pid}/statm")
    return int(told.split()[5]) * _PAGE if told else 0


def mappings(least: int) -> list[tuple[int, int]]:
    """Find the readable and writable anonymous memory of the process.

    Args:
        least: Size of the smallest that counts [bytes].

    Returns:
        Address of the first byte of each, and of the byte behind it.
    """
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as file:
        fields = [line.split() for line in file]
    spans = [tuple(int(address, 16) for address in each[0].split("-")) for each in fields if each[1:] == _ANONYMOUS]
    return [(begin, end) for begin, end in spans if end - begin >= least]


def _told(path: str) -> str | None:
    """Read a one-line file; None if the process or thread has ended; called often to watch idle processes."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        return os.read(descriptor, _LINE).decode("ascii", errors="replace")
    except OSError:  # it has ended meanwhile
        return None
    finally:
        os.close(descriptor)
