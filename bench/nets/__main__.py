"""``python -m bench.nets``: the figures of nets, next to peers of the same run; for ``scripts/bench.sh --nets``."""

import argparse
import sys
from pathlib import Path

from bench.nets import firings, idle, journals, links, searches
from bench.nets.peers import installed_peers
from bench.part import Part, Work

ROUNDS = 5
FIRINGS = 20_000
TRIPS = 1000
IDLE_S = 5.0
SOURCES = Path(__file__).resolve().parents[2] / "ros_ws" / "src"
ENTRIES = 100_000

GROUPS = {
    "firing": "firings a second for a command, with action, guard and journal, next to libpetri, SNAKES and pm4py",
    "node": "the same of a node with guard, action and journal, told to a display",
    "idle": "CPU time while a thousand actions run and nothing happens, in the core and in a node",
    "search": "markings a second of explicit search; time and memory of large spaces",
    "verify": "pnt verify of all shipped nets, as before a start",
    "journal": "entries of a journal a second, and coming back from them",
    "remote": "round trip of a token between two processes, in turns with a bare topic",
}

_ABOUT = """Measures nets: execution, analysis, remote tokens and the journal, next to peers and baselines of the
same run. CPU time, but for round trips. Peers run in processes of their own; where one is missing, its rows say so."""


def main() -> int:
    """Runs the command; returns its exit code."""
    part = Part("nets", _ABOUT, GROUPS)
    part.parser.add_argument("--quick", action="store_true", help="a tenth of everything: does it run?")
    return part.run(work)


def work(options: argparse.Namespace, folder: Path) -> Work:
    """What measures each group."""
    shipped = sorted(SOURCES.glob("*/*/nets/*.yaml"))
    share = 10 if options.quick else 1
    rounds = 1 if options.quick else ROUNDS
    return {
        "firing": lambda: firings.lines(installed_peers(), FIRINGS // share, rounds, folder),
        "node": lambda: firings.node_lines(FIRINGS // share, rounds, folder),
        "idle": lambda: idle.lines(IDLE_S / share, rounds, folder),
        "search": lambda: searches.lines(rounds),
        "verify": lambda: searches.shipped_lines(shipped, folder),
        "journal": lambda: journals.lines(ENTRIES // share, folder),
        "remote": lambda: links.lines(TRIPS // share, rounds, folder),
    }


if __name__ == "__main__":
    sys.exit(main())
