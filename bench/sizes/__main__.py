"""``python -m bench.sizes``: cost against size; for ``scripts/bench.sh --sizes``."""

import argparse
import sys
from pathlib import Path

from bench.part import Part, Work
from bench.sizes import arms, commands, nets, solver, subscribers
from im_dispatcher.accuracy import FIRST_POSES
from im_mcs.limits.configuration import load_config

GROUPS = {
    "solver": f"CPU time of the calibration of {FIRST_POSES} to 200 poses",
    "commands": f"the command with {FIRST_POSES} to 200 poses, and with a bag that records all topics",
    "arms": "CPU time of a tick of servo and physics while one arm moves, and both",
    "nets": "CPU time of a firing and of a proof, nets of 10 to 1,000 places",
    "subscribers": "CPU time of a node's firing that 0 to 20 subscribers hear",
}

_ABOUT = """Measures what things cost as they grow. Each size is given as a ratio to the smallest of the same run: what
costs the same for each pose, place or subscriber grows as the size does, and no faster."""


def main() -> int:
    """Run the command; its exit code."""
    part = Part("sizes", _ABOUT, GROUPS)
    part.parser.add_argument("--quick", action="store_true", help="fewer sizes, shorter turns")
    part.parser.add_argument("--port", type=int, default=8080, help="of the display (default: %(default)d)")
    return part.run(_work)


def _work(options: argparse.Namespace, folder: Path) -> Work:
    """What measures each group."""
    quick = options.quick
    return {
        "solver": lambda: solver.lines((FIRST_POSES, 40, 200), rounds=1 if quick else 3),
        "commands": lambda: commands.lines((FIRST_POSES, *((40,) if quick else (40, 100, 200))), options.port, folder),
        "arms": lambda: arms.lines(load_config(None), moves=2 if quick else 6),
        "nets": lambda: nets.lines((10, 100, 1000), firings=10_000 if quick else 100_000),
        "subscribers": lambda: subscribers.lines((0, 1, 20) if quick else (0, 1, 5, 20), 2_000, folder),
    }


if __name__ == "__main__":
    sys.exit(main())
