"""Figures of the journal: firings with an observer and a journal, entries a second, and how long coming back takes."""

from pathlib import Path

from bench.figures import Line
from bench.nets.player import Counter, never
from im_core.clock import cpu, monotonic
from im_core.errors import StateError
from im_pnt.distributed.exchange import Exchange
from im_pnt.distributed.link import Link
from im_pnt.execution.actions import FunctionRunner
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import Functions
from im_pnt.journal.journal import Journal
from im_pnt.journal.log import Sync
from im_pnt.model.net import Net
from im_pnt_analysis.simulation.families import ACTION, philosophers, ring

PLACES = 10
SIZES = (10, 100, 1000)
A_TURN = 1000
"""Firings of a turn of a node."""
_NEVER_COMPACT = 1 << 40
_DISK_COMMITS = 300


class Machine:
    """A process with one net, an observer and its journal, as a node has them; begins anew, or where its journal ends.

    Args:
        net: The net; its actions are called :data:`~im_pnt_analysis.simulation.families.ACTION`.
        folder: Folder of the journal.
        sync: When a record counts as written.

    Raises:
        JournalError: The journal cannot be used.
    """

    def __init__(self, net: Net, folder: Path, sync: Sync = Sync.OS) -> None:
        self.journal = Journal(folder, "bench", sync=sync, compact_bytes=_NEVER_COMPACT)
        exchange = Exchange("bench", self.journal.epoch)
        link = Link(
            "bench",
            self.journal.epoch,
            exchange.receive,
            exchange.refused,
            lambda node, why, messages: None,
            lambda node: None,
            lambda node, packet: None,
        )
        functions = Functions({ACTION: lambda ctx: None})
        runner = self.journal.guard(FunctionRunner(functions, exchange, never))
        record = self.journal.recorder(net.name)
        self.executor = Executor(net, functions, runner, exchange, Counter(), record=record)
        exchange.add(self.executor)
        self.journal.start(exchange, link)

    def fire(self, firings: int, at_once: int) -> None:
        """Fires, and commits to the journal.

        Args:
            firings: How often.
            at_once: Firings of a commit.
        """
        for _ in range(0, firings, at_once):
            self.executor.pump(at_once)
            self.journal.commit()


def lines(entries: int, folder: Path) -> list[Line]:
    """Fires with an action, an observer and a journal; writes a journal for each firing, and for each hundred.

    Args:
        entries: How many, of each net.
        folder: Where the journals go.

    Raises:
        StateError: What came back is not what was written.
    """
    found: list[Line] = []
    for make in (ring, philosophers):
        for places in SIZES:
            machine = Machine(make(places, action=True), folder / f"{make.__name__}_{places}")
            machine.fire(A_TURN, A_TURN)
            began = cpu()
            machine.fire(entries, A_TURN)
            used = cpu() - began
            machine.journal.close()
            name = f"firings with action, observer and journal, {make.__name__} of {places}"
            found.append(Line(name, entries / used, "1/s"))
    for at_once in (1, 100):
        path = folder / f"journal_{at_once}"
        machine = Machine(ring(PLACES), path)
        began = cpu()
        machine.fire(entries, at_once)
        used = cpu() - began
        marking, sequence = machine.executor.marking(), machine.executor.sequence
        machine.journal.close()
        found.append(Line(f"journal, {at_once} firings a commit", entries / used, "1/s"))
        began = cpu()
        again = Machine(ring(PLACES), path)
        used = cpu() - began
        again.journal.close()
        if (again.executor.marking(), again.executor.sequence) != (marking, sequence):
            raise StateError(f"a journal of {sequence} firings brought back {again.executor.sequence}")
        found.append(Line(f"  recovery of {entries:,} entries", used, "s"))
    for at_once in (1, 100):
        machine = Machine(ring(PLACES), folder / f"disk_{at_once}", Sync.DISK)
        began = monotonic()  # it waits for the disk, which is no CPU time
        machine.fire(_DISK_COMMITS * at_once, at_once)
        took = monotonic() - began
        machine.journal.close()
        found.append(Line(f"journal_sync: disk, {at_once} firings a commit", _DISK_COMMITS * at_once / took, "1/s"))
    return found
