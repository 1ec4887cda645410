"""Figures of execution: firings a second for a command, next to peers that fire the same nets in turns."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from bench.figures import Line
from bench.nets.families import philosophers, ring
from bench.nets.peers import Peers, plain
from bench.nets.player import Work
from bench.nets.workers import Worker, number, own
from im_core.errors import ImError

SIZES = (10, 100, 1000)
COMPARED = 100
"""Size at which tokens alone are compared with peers."""
NETS = {"ring": ring, "philosophers": philosophers}
MOST_SPREAD = 1.5
_WARM_UP = 1000
_OF_PEERS = {"libpetri": 5.0, "snakes": 0.05, "pm4py": 0.05}
"""Share of our firings that a peer is asked for, so that all take about as long."""


class Rates:
    """Processes that fire, each a net, in turns."""

    def __init__(self, stack: ExitStack, firings: int) -> None:
        self._stack = stack
        self._firings = firings
        self._workers: dict[str, tuple[Worker, int]] = {}
        self._rates: dict[str, list[float]] = {}
        self.missing: dict[str, str] = {}

    def add_own(self, name: str, family: str, places: int, work: Work = Work.NONE, folder: Path | None = None) -> None:
        """Adds a net of ours, which works for a command and is observed; with a journal where it is given a folder.

        Raises:
            LinkError: The process does not start.
        """
        worker = self._stack.enter_context(own("bench.nets.player"))
        worker.ask("load", family=family, places=places, work=work, folder=str(folder or ""))
        self._enter(name, worker, self._firings)

    def add_peer(self, name: str, peers: Peers, peer: str, net: Mapping[str, object], *options: str) -> None:
        """Adds a net of a peer; if that cannot be, :attr:`missing` says why."""
        try:
            worker = self._stack.enter_context(peers.start(peer, *options))
            worker.ask("load", net=dict(net))
            self._enter(name, worker, max(1, int(self._firings * _OF_PEERS[peer])))
        except ImError as error:
            self.missing[name] = error.message

    def _enter(self, name: str, worker: Worker, firings: int) -> None:
        worker.ask("fire", firings=min(_WARM_UP, firings))
        self._workers[name] = (worker, firings)
        self._rates[name] = []

    def run(self, rounds: int) -> None:
        """Has each of them fire in turn.

        Raises:
            LinkError: One of the processes has died.
        """
        for _ in range(rounds):
            for name, (worker, firings) in self._workers.items():
                answer = worker.ask("fire", firings=firings)
                self._rates[name].append(number(answer, "firings") / max(1e-9, number(answer, "cpu_s")))

    def rate(self, name: str) -> float | None:
        """Firings a second of CPU time, median of the rounds; None where it could not be measured."""
        return median(self._rates[name]) if self._rates.get(name) else None


def lines(peers: Peers, firings: int, rounds: int, folder: Path) -> list[Line]:
    """Measure observed firings for a command: of tokens alone, with an action each, with guard, action and journal.

    SNAKES and pm4py move tokens alone. libpetri calls a Python function for each firing and has its in-memory event
    store on; its nets know no commands, and have neither guard nor journal.

    Raises:
        ImError: Our own processes fail.
    """
    found: list[Line] = []
    for family, make in NETS.items():
        with ExitStack() as stack:
            rates = Rates(stack, firings)
            for places in SIZES:
                for work in Work:
                    journal = folder / f"{family}_{places}" if work is Work.ALL else None
                    rates.add_own(f"{work} {places}", family, places, work, journal)
                rates.add_peer(f"libpetri {places}", peers, "libpetri", plain(make(places)))
            net = plain(make(COMPARED))
            rates.add_peer("SNAKES", peers, "snakes", net)
            rates.add_peer("SNAKES in turn", peers, "snakes", net, "--in-turn")
            rates.add_peer("pm4py", peers, "pm4py", net)
            rates.run(rounds)
        bare = {places: rates.rate(f"{Work.NONE} {places}") for places in SIZES}
        for places in SIZES:
            found.append(Line(f"firings for a command, {family} of {places}", bare[places], "1/s"))
            found += [
                _against(f"  with {work}", rates, f"{work} {places}", f"libpetri {places}", "libpetri")
                for work in (Work.ACTION, Work.ALL)
            ]
        measured = [rate for rate in bare.values() if rate]
        found.append(
            Line("  fastest size over slowest", max(measured), "1/s", min(measured), "slowest", bar=MOST_SPREAD)
        )
        found += [
            _against(f"  {COMPARED} places, tokens alone, against {peer}", rates, f"{Work.NONE} {COMPARED}", peer, peer)
            for peer in ("SNAKES", "SNAKES in turn", "pm4py")
        ]
    return found


def node_lines(firings: int, rounds: int, folder: Path) -> list[Line]:
    """Firings of a node with guard, action and journal, while another process has subscribed to them.

    Raises:
        ImError: The processes fail.
    """
    node = own("bench.nets.nodes.firing", "fire", str(folder))
    shown = own("bench.nets.nodes.firing", "show", str(folder))
    with node, shown:
        node.ask("ready", subscribers=1)
        found = []
        for _ in range(rounds):
            answer = node.ask("fire", firings=firings)
            found.append(number(answer, "firings") / number(answer, "cpu_s"))
        told = number(shown.ask("heard"), "heard")
    lines = [Line("firings of a node, guard, action, journal, display", median(found), "1/s")]
    return [*lines, Line("  share of them that the display heard", told / number(answer, "sequence"), "")]


def _against(name: str, rates: Rates, own: str, peers: str, peer: str) -> Line:
    """Compare a rate of ours with that of a peer; if the peer could not be measured, the line says why."""
    baseline = rates.rate(peers)
    return Line(name, rates.rate(own), "1/s", baseline, peer if baseline is not None else rates.missing[peers])
