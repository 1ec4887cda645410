"""What running processes use: CPU time and memory."""

from collections.abc import Iterable
from pathlib import Path


def cpu_s(pid: int) -> float:
    """CPU time that a process has used so far, in the threads that it has [s]."""
    threads = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(thread.read_text(encoding="ascii").split()[0]) for thread in threads) * 1e-9


def memory_mib(pids: Iterable[int]) -> float:
    """Memory of processes, shared pages counted once in proportion (PSS) [MiB]; without those that ended."""
    total = 0
    for pid in pids:
        try:
            text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
        except OSError:
            continue
        total += next((int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:")), 0)
    return total / 1024.0
