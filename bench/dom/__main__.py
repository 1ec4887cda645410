"""``python -m bench.dom``: the figures of the Data Object Manager; for ``scripts/bench.sh --dom``."""

import argparse
import sys
import tempfile
from pathlib import Path

from bench.dom import kills, speed
from bench.figures import Line, measure, report
from im_core.errors import ImError

PARTS = {
    "speed": "10,000 small puts and gets beside those of a bare service, wall and CPU time of all processes",
    "kills": "a store that is killed 200 times: is all there that it has acknowledged?",
}

_DESCRIPTION = """Measures the Data Object Manager. All figures are written as JSON into results/ too.

parts:
""" + "\n".join(f"  {name:10} {what}" for name, what in PARTS.items())


def main() -> int:
    """Run the command.

    Returns:
        Exit code: 0 all bars are met, 1 a bar is missed or a measurement failed, 2 bad usage, 130 interrupted.
    """
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="bench --dom", description=_DESCRIPTION, formatter_class=raw)
    parser.add_argument("parts", nargs="*", metavar="PART", help="only these (all)")
    parser.add_argument("--kills", type=int, default=200, help="how many (default: %(default)s)")
    options = parser.parse_args()
    unknown = [part for part in options.parts if part not in PARTS]
    if unknown:
        parser.error(f"there is no part '{unknown[0]}'; there are {', '.join(PARTS)}")
    try:
        work = {"speed": speed.lines, "kills": lambda: _killed(options.kills)}
        lines, failed = measure(work, options.parts or list(PARTS))
    except KeyboardInterrupt:
        print("bench: interrupted", file=sys.stderr)
        return 130
    return 0 if report("bench-dom", lines) and not failed else 1


def _killed(count: int) -> list[Line]:
    """How many acknowledged changes were lost.

    Raises:
        ImError: One was; says which.
    """
    with tempfile.TemporaryDirectory(prefix="im_bench_") as folder:
        try:
            looked = sum(kills.kill_once(Path(folder), seed) for seed in range(count))
        except AssertionError as error:
            raise ImError(str(error)) from error
    return [Line(f"acknowledged changes lost in {count} kills", 0.0, "", None, f"of {looked:,}", 0.0)]


if __name__ == "__main__":
    sys.exit(main())
