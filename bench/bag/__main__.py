"""``python -m bench.bag``: recording beside a running machine; for ``scripts/bench.sh --bag``."""

import argparse
import sys
from pathlib import Path

from bench.bag.recording import recording_lines
from bench.part import Part, Work, positive

GROUPS = {"recording": "messages a second through the recorder, gaps in their numbers, and its CPU time"}

_ABOUT = """Starts the whole machine in real time, has it calibrate again and again, and records all topics."""


def main() -> int:
    """Run the command; its exit code."""
    part = Part("bag", _ABOUT, GROUPS)
    add = part.parser.add_argument
    add("--seconds", type=positive(float), default=600.0, help="how long to record, at least (default: %(default)g)")
    add("--seed", type=int, default=1, help="of the testbed (default: %(default)d)")
    add("--port", type=int, default=8080, help="of the display (default: %(default)d)")
    return part.run(_work)


def _work(options: argparse.Namespace, folder: Path) -> Work:
    return {"recording": lambda: recording_lines(options.seconds, options.seed, options.port, folder)}


if __name__ == "__main__":
    sys.exit(main())
