"""Figures of the journal: entries a second, and how long coming back takes."""

from pathlib import Path

from bench.figures import Line
from bench.nets.player import Player, Work, working
from im_core.clock import cpu, monotonic
from im_core.errors import StateError
from im_pnt_node.journal.journal import Journal
from im_pnt_node.journal.log import Sync

PLACES = 10
_NEVER_COMPACT = 1 << 40
_DISK_COMMITS = 300


def lines(entries: int, folder: Path) -> list[Line]:
    """Write a journal for each firing of a ring, and for each hundred, and come back from it.

    Raises:
        StateError: What came back is not what was written.
    """
    found: list[Line] = []
    net = working("ring", PLACES, Work.NONE)
    for at_once in (1, 100):
        journal = _journal(folder / f"journal_{at_once}")
        player = Player(net, journal)
        began = cpu()
        player.fire(entries, at_once)
        used = cpu() - began
        marking, sequence = player.executor.marking(), player.executor.sequence
        journal.close()
        found.append(Line(f"journal, {at_once} firings a commit", entries / used, "1/s"))
        began = cpu()
        journal = _journal(folder / f"journal_{at_once}")
        again = Player(net, journal)
        used = cpu() - began
        journal.close()
        if (again.executor.marking(), again.executor.sequence) != (marking, sequence):
            raise StateError(f"a journal of {sequence} firings brought back {again.executor.sequence}")
        found.append(Line(f"  recovery of {entries:,} entries", used, "s"))
    for at_once in (1, 100):
        journal = _journal(folder / f"disk_{at_once}", Sync.DISK)
        player = Player(net, journal)
        began = monotonic()  # it waits for the disk, which is no CPU time
        player.fire(_DISK_COMMITS * at_once, at_once)
        took = monotonic() - began
        journal.close()
        found.append(Line(f"journal_sync: disk, {at_once} firings a commit", _DISK_COMMITS * at_once / took, "1/s"))
    return found


def _journal(folder: Path, sync: Sync = Sync.OS) -> Journal:
    """Open a journal that is never compacted, so that each entry is read again."""
    return Journal(folder, "bench", sync=sync, compact_bytes=_NEVER_COMPACT)
