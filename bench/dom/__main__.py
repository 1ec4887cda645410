"""``python -m bench.dom``: the figures of the Data Object Manager; for ``scripts/bench.sh --dom``."""

import argparse
import sys
from pathlib import Path

from bench.dom import kills, speed
from bench.figures import Line
from bench.part import Part, Work, positive
from im_core.errors import ImError

GROUPS = {
    "speed": "10,000 small puts and gets beside those of a bare service, wall and CPU time of all processes",
    "kills": "a store that is killed 200 times: is all there that it has acknowledged?",
    "power": "a store that loses its power 200 times, on a disk that forgets what was not synchronised: likewise",
}

_ABOUT = "Measures the Data Object Manager. All figures are written as JSON into results/ too."


def main() -> int:
    """Run the command; its exit code."""
    part = Part("dom", _ABOUT, GROUPS)
    part.parser.add_argument("--kills", type=positive(int), default=200, help="how many (default: %(default)s)")
    return part.run(_work)


def _work(options: argparse.Namespace, folder: Path) -> Work:
    return {
        "speed": speed.lines,
        "kills": lambda: _killed(options.kills, folder, power=False),
        "power": lambda: _killed(options.kills, folder, power=True),
    }


def _killed(count: int, folder: Path, *, power: bool) -> list[Line]:
    """How many acknowledged changes were lost.

    Raises:
        ImError: One was; says which.
    """
    try:
        stores = folder / ("power" if power else "kills")
        stores.mkdir()
        looked = sum(kills.kill_once(stores, seed, power=power) for seed in range(count))
    except AssertionError as error:
        raise ImError(str(error)) from error
    what = "losses of power" if power else "kills"
    return [Line(f"acknowledged changes lost in {count} {what}", 0.0, "", None, f"of {looked:,}", 0.0)]


if __name__ == "__main__":
    sys.exit(main())
