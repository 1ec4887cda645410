"""What running processes use: CPU time and memory."""

import ctypes
import os
import time
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path

_LIBC = ctypes.CDLL(None)


def cpu_s(pid: int) -> float:
    """CPU time that a process has used so far, in threads that ended, too [s].

    Raises:
        ProcessLookupError: It has ended.
    """
    its_clock = ctypes.c_int()
    if _LIBC.clock_getcpuclockid(pid, ctypes.byref(its_clock)) != 0:
        raise ProcessLookupError(f"there is no process {pid}")
    return time.clock_gettime(its_clock.value)


def ended_children_s(pid: int) -> float:
    """CPU time that children of a process had used which ended, and theirs [s]; 0 if it has ended itself."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[13]) + int(fields[14])) / os.sysconf("SC_CLK_TCK")


def children(pid: int) -> list[int]:
    """Processes that a process has started, and that have not ended."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):  # a thread may end meanwhile
            found += map(int, (task / "children").read_text(encoding="ascii").split())
    return found


def descendants(pid: int) -> list[int]:
    """Processes that a process has started, and those that they have."""
    return [each for child in children(pid) for each in (child, *descendants(child))]


def memory_mib(pids: Iterable[int]) -> float:
    """Memory of processes, shared pages counted once in proportion (PSS) [MiB]; without those that ended."""
    return _kib(pids, ("Pss",)) / 1024.0


def own_memory_mib(pids: Iterable[int]) -> float:
    """Memory that only these processes can give back: anonymous pages and what is swapped of them [MiB].

    Those of a parent and its copies are counted once in proportion. Pages of files are left out: they are the kernel's,
    and of a library that others have loaded, too, the share changes when those begin and end.
    """
    return _kib(pids, ("Pss_Anon", "SwapPss")) / 1024.0


def _kib(pids: Iterable[int], fields: Collection[str]) -> int:
    """The sum of some fields of the mappings of processes [KiB]."""
    total = 0
    for pid in pids:
        try:
            text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
        except OSError:
            continue
        found = (line.partition(":") for line in text.splitlines())
        total += sum(int(rest.split()[0]) for name, _, rest in found if name in fields)
    return total


def program(pid: int) -> str:
    """What a process runs: the module of Python, else its program, 15 letters of it; empty if it has ended."""
    folder = Path(f"/proc/{pid}")
    try:
        words = (folder / "cmdline").read_text(encoding="utf-8", errors="replace").split("\0")[1:]
        name = (folder / "comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
    return words[words.index("-m") + 1] if "-m" in words else name
