"""What the kernel tells of running processes and threads in ``/proc``."""

from pathlib import Path
from typing import NamedTuple


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
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return None
    return stat[stat.rindex(")") + 2 :].split()  # the command name may hold blanks and parentheses


def scheduled(pid: int, thread: int | None = None) -> Scheduled | None:
    """How the main thread of a process, or one of its threads, was scheduled; None if it has ended or nobody counts."""
    folder = f"/proc/{pid}" if thread is None else f"/proc/{pid}/task/{thread}"
    try:
        ran, queued, _ = Path(f"{folder}/schedstat").read_text(encoding="ascii").split()
    except (OSError, ValueError):
        return None
    return Scheduled(int(ran) * 1e-9, int(queued) * 1e-9)
