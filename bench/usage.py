"""Figures of a running machine: its memory."""

from collections.abc import Iterable
from pathlib import Path


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
