"""``python -m bench.display``: the figures of the page; for ``scripts/bench.sh --display``."""

import argparse
import sys
from pathlib import Path

from bench.display import frames, viewers
from bench.part import Part, Work, positive

GROUPS = {
    "frames": "frames a second in headless Chromium, of a net with 1,000 places that fires 500 times a second",
    "viewers": "share of a core for 20 viewers of that net, and of one with 48 places that fires 20 times a second",
}

_ABOUT = """Measures the page. Its nets fire in the process that measures; the process of the page and the browser are
as users have them. All figures are written as JSON into results/ too."""


def main() -> int:
    """Run the command; its exit code."""
    part = Part("display", _ABOUT, GROUPS)
    part.parser.add_argument("--seconds", type=positive(float), default=10.0, help="of each (default: %(default)s)")
    return part.run(_work)


def _work(options: argparse.Namespace, _: Path) -> Work:
    return {"frames": lambda: frames.lines(options.seconds), "viewers": lambda: viewers.lines(options.seconds)}


if __name__ == "__main__":
    sys.exit(main())
