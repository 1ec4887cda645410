"""Figures of the journal: entries a second, and how long it takes to come back."""

from pathlib import Path

from im_core.clock import cpu
from im_core.errors import StateError
from im_core.figures import Line
from im_pnt.bench.nets import ring
from im_pnt.bench.player import never
from im_pnt.exchange import Exchange
from im_pnt.executive import Executive
from im_pnt.functions import Functions
from im_pnt.journal.process_journal import Journal
from im_pnt.link import Link
from im_pnt.runner import FunctionRunner

PLACES = 10
_NEVER_COMPACT = 1 << 40


class Machine:
    """A process with one net and its journal, as a node has them; begins anew, or where its journal ends.

    Args:
        folder: Folder of the journal.

    Raises:
        JournalError: The journal cannot be used.
    """

    def __init__(self, folder: Path) -> None:
        self.journal = Journal(folder, "bench", compact_bytes=_NEVER_COMPACT)
        exchange = Exchange("bench", self.journal.epoch)
        link = Link(
            "bench",
            self.journal.epoch,
            exchange.receive,
            exchange.refused,
            lambda node, messages: None,
            lambda node: None,
            lambda node, packet: None,
        )
        functions = Functions()
        net = ring(PLACES)
        runner = self.journal.guard(FunctionRunner(functions, exchange, never))
        self.executive = Executive(net, functions, runner, exchange, record=self.journal.recorder(net.name))
        exchange.add(self.executive)
        self.journal.start(exchange, link)

    def fire(self, firings: int, at_once: int) -> None:
        """Fires, and commits to the journal.

        Args:
            firings: How often.
            at_once: Firings of a commit.
        """
        for _ in range(0, firings, at_once):
            self.executive.pump(at_once)
            self.journal.commit()


def lines(entries: int, folder: Path) -> list[Line]:
    """Writes a journal, with a commit for each firing and for each hundred, and comes back from it.

    Args:
        entries: How many.
        folder: Where the journals go.

    Raises:
        StateError: What came back is not what was written.
    """
    found: list[Line] = []
    for at_once in (1, 100):
        path = folder / f"journal_{at_once}"
        machine = Machine(path)
        began = cpu()
        machine.fire(entries, at_once)
        used = cpu() - began
        marking, sequence = machine.executive.marking(), machine.executive.sequence
        machine.journal.close()
        found.append(Line(f"journal, {at_once} firings a commit", entries / used, "1/s"))
        began = cpu()
        again = Machine(path)
        used = cpu() - began
        again.journal.close()
        if (again.executive.marking(), again.executive.sequence) != (marking, sequence):
            raise StateError(f"a journal of {sequence} firings brought back {again.executive.sequence}")
        found.append(Line(f"  recovery of {entries:,} entries", used, "s"))
    return found
