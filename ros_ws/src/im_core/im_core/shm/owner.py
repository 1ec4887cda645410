"""Identity of a process: its pid alone is reused by the kernel, pid and start time together are not."""

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ProcessId:
    """A process of this host.

    Attributes:
        pid: Process id; 0 stands for "no process".
        start: Start time of the process since boot [clock ticks], field 22 of ``/proc/<pid>/stat``.
    """

    pid: int
    start: int

    @classmethod
    def of(cls, pid: int) -> "ProcessId":
        """Identity of a process that runs now; start is -1 if there is none."""
        return cls(pid, _start_of_running(pid))

    @classmethod
    def current(cls) -> "ProcessId":
        """Identity of the calling process."""
        return cls.of(os.getpid())

    def alive(self) -> bool:
        """Whether this very process still runs; one that died and was not reaped yet does not."""
        return self.pid > 0 and _start_of_running(self.pid) == self.start


def _start_of_running(pid: int) -> int:
    """Start time of a running process, -1 if it does not exist or is a zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return -1
    fields = stat[stat.rindex(")") + 2 :].split()  # the command name may hold blanks and parentheses
    return -1 if fields[0] in "ZX" else int(fields[19])
