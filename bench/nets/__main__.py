"""``python -m bench.nets``: the figures of nets, next to peers of the same run; for ``scripts/bench.sh --nets``."""

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from bench.figures import Line, measure, report
from bench.nets import firings, idle, journals, links, searches
from bench.nets.peers import Peers

ROUNDS = 5
FIRINGS = 100_000
TRIPS = 1000
IDLE_S = 5.0
ENTRIES = 100_000

GROUPS = {
    "firings": "observed firings a second of rings and dining philosophers, next to SNAKES and pm4py",
    "actions": "the same with a Python action, a guard, a journal, in turns with libpetri and its event store",
    "node": "firings a second of a node with guard, action and journal, told to a display",
    "idle": "CPU time while a thousand actions run and nothing happens, in the core and in a node",
    "search": "markings a second of explicit search; time and memory of large spaces",
    "verify": "pnt prove of all shipped nets, as before a start",
    "journal": "firings with an action, an observer and a journal; entries a second, and coming back from them",
    "remote": "round trip of a token between two processes, in turns with a bare topic",
}

_DESCRIPTION = """Measures nets: execution, analysis, remote tokens and the journal, next to peers and baselines of the
same run. CPU time, but for round trips. Peers run in processes of their own; where one is missing, its rows say so.

groups:
""" + "\n".join(f"  {name:9} {what}" for name, what in GROUPS.items())


def main() -> int:
    """Runs the command.

    Returns:
        Exit code: 0 all bars that could be measured are met, 1 a bar is missed or a measurement failed, 2 bad usage,
        130 interrupted.
    """
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="bench --nets", description=_DESCRIPTION, formatter_class=raw)
    parser.add_argument("groups", nargs="*", metavar="GROUP", help="only these (all)")
    parser.add_argument("--quick", action="store_true", help="a tenth of everything: does it run?")
    given = parser.add_argument_group("given by scripts/bench.sh")
    given.add_argument("--peers", type=Path, metavar="PYTHON", help="interpreter of the environment of the peers")
    given.add_argument("--peers-missing", default="", metavar="WHY", help="why there is none")
    given.add_argument("--peer-programs", type=Path, required=True, metavar="FOLDER", help="programs of the peers")
    given.add_argument("--shipped", type=Path, nargs="+", required=True, metavar="FILE", help="nets to verify")
    options = parser.parse_args()
    unknown = [group for group in options.groups if group not in GROUPS]
    if unknown:
        parser.error(f"there is no group '{unknown[0]}'; there are {', '.join(GROUPS)}")
    try:
        lines, failed = measure_groups(options.groups or list(GROUPS), options)
    except KeyboardInterrupt:
        print("bench: interrupted", file=sys.stderr)
        return 130
    return 0 if report("bench-nets", lines) and not failed else 1


def measure_groups(groups: Sequence[str], options: argparse.Namespace) -> tuple[list[Line], bool]:
    """Measures groups of figures, as :func:`bench.figures.measure` does.

    Args:
        groups: Their names.
        options: Of the command line.

    Returns:
        The lines, and whether a group failed.
    """
    peers = Peers(options.peers, options.peer_programs, options.peers_missing)
    share = 10 if options.quick else 1
    rounds = 1 if options.quick else ROUNDS
    with tempfile.TemporaryDirectory(prefix="im_bench_") as name:
        folder = Path(name)
        work: dict[str, Callable[[], list[Line]]] = {
            "firings": lambda: firings.plain_lines(peers, FIRINGS // share, rounds),
            "actions": lambda: firings.action_lines(peers, FIRINGS // share, rounds, folder),
            "node": lambda: firings.node_lines(FIRINGS // share // 5, rounds, folder),
            "idle": lambda: idle.lines(IDLE_S / share, rounds, folder),
            "search": lambda: searches.lines(rounds),
            "verify": lambda: searches.shipped_lines(options.shipped, folder),
            "journal": lambda: journals.lines(ENTRIES // share, folder),
            "remote": lambda: links.lines(TRIPS // share, rounds, folder),
        }
        return measure(work, groups)


if __name__ == "__main__":
    sys.exit(main())
