"""Figures of execution: firings a second, next to peers that fire the same nets in turns."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from bench.figures import Line
from bench.nets.peers import Peers, plain
from bench.nets.player import Work
from bench.nets.workers import Worker, number, own
from im_core.errors import ImError
from im_pnt_analysis.simulation.families import philosophers, ring

SIZES = (10, 100, 1000)
NETS = {"ring": ring, "philosophers": philosophers}
LEAST_A_SECOND = {"ring": 482_000.0, "philosophers": 138_000.0}
"""Twice what an observed net of 100 fired a second when each firing was told by itself."""
MOST_SPREAD = 1.5
TIMES_SNAKES = 50.0
_WARM_UP = 1000
_OF_PEERS = {"libpetri": 1.0, "snakes": 0.01, "pm4py": 0.005}
"""Share of our firings that a peer is asked for, so that all take about as long."""


class Rates:
    """Processes that fire, each a net, in turns.

    Args:
        stack: Ends them.
        firings: Firings of a turn.
    """

    def __init__(self, stack: ExitStack, firings: int) -> None:
        self._stack = stack
        self._firings = firings
        self._workers: dict[str, tuple[Worker, int]] = {}
        self._rates: dict[str, list[float]] = {}
        self.missing: dict[str, str] = {}

    def add_own(self, name: str, family: str, places: int, work: Work = Work.NONE, folder: Path | None = None) -> None:
        """Adds a net of ours, observed; with a journal where it is given a folder.

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

        Args:
            rounds: How often.

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


def plain_lines(peers: Peers, firings: int, rounds: int) -> list[Line]:
    """Observed firings without actions: our rate, that it does not depend on the size, and its ratio to SNAKES.

    Args:
        peers: The peers.
        firings: Firings of a turn.
        rounds: Turns.

    Raises:
        ImError: Our own processes fail.
    """
    lines: list[Line] = []
    for family, make in NETS.items():
        with ExitStack() as stack:
            rates = Rates(stack, firings)
            for places in SIZES:
                rates.add_own(f"im {places}", family, places)
            net = plain(make(100))
            rates.add_peer("SNAKES", peers, "snakes", net)
            rates.add_peer("SNAKES in turn", peers, "snakes", net, "--in-turn")
            rates.add_peer("pm4py", peers, "pm4py", net)
            rates.run(rounds)
            own = {places: rates.rate(f"im {places}") for places in SIZES}
            for places, rate in own.items():
                name = f"firings, {family} of {places} places, observed"
                lines.append(Line(name, rate, "1/s", bar=LEAST_A_SECOND[family], at_least=True))
            measured = [rate for rate in own.values() if rate]
            fastest, slowest = max(measured), min(measured)
            lines.append(Line("  fastest size over slowest", fastest, "1/s", slowest, "slowest", bar=MOST_SPREAD))
            lines += [
                _against(rates, own[100], "SNAKES", TIMES_SNAKES),
                _against(rates, own[100], "SNAKES in turn", None),
                _against(rates, own[100], "pm4py", None),
            ]
    return lines


def action_lines(peers: Peers, firings: int, rounds: int, folder: Path) -> list[Line]:
    """Observed firings with a Python action each, then with a guard too, then with a journal, next to libpetri.

    The peer has its in-memory event store on, and no guards; it keeps no journal.

    Args:
        peers: The peers.
        firings: Firings of a turn.
        rounds: Turns.
        folder: Where the journals go.

    Raises:
        ImError: Our own processes fail.
    """
    lines: list[Line] = []
    for family, make in NETS.items():
        for places in SIZES:
            with ExitStack() as stack:
                rates = Rates(stack, firings)
                for work in (Work.ACTION, Work.GUARDED):
                    rates.add_own(work, family, places, work)
                journalled = {work: f"{work}, journal" for work in Work}
                for work, name in journalled.items():
                    rates.add_own(name, family, places, work, folder / f"{family}_{places}_{work.name}")
                rates.add_peer("libpetri", peers, "libpetri", plain(make(places)))
                rates.run(rounds)
                for work in (Work.ACTION, Work.GUARDED):
                    name = f"firings with {work}, {family} of {places}"
                    lines.append(_against(rates, rates.rate(work), "libpetri", 1.0, name))
                for work, name in journalled.items():
                    lines.append(Line(f"  with {work}, and a journal", rates.rate(name), "1/s"))
    return lines


def node_lines(firings: int, rounds: int, folder: Path) -> list[Line]:
    """Firings of a node with guard, action and journal, while another process has subscribed to them.

    Args:
        firings: Firings of a turn.
        rounds: Turns.
        folder: Where net and journal go.

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


def _against(rates: Rates, own: float | None, peer: str, bar: float | None, name: str = "") -> Line:
    """One line of ours against a peer's; if the peer could not be measured, a line that says why."""
    name = name or f"  100 places, against {peer}"
    baseline = rates.rate(peer)
    if baseline is None:
        return Line(name, None, "1/s", None, rates.missing.get(peer, f"{peer} was not measured"), bar, at_least=True)
    return Line(name, own, "1/s", baseline, peer, bar, at_least=True)
