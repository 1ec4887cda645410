"""``python -m bench.vss``: the figures of VSS; for ``scripts/bench.sh --vss``."""

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from bench.figures import Line, measure, measured_by_machine, report
from bench.vss import cameras, coverage
from im_core.errors import ImError

PARTS = {
    "cameras": "frames a second of the simulated cameras alone, through each renderer, and the steps of a frame",
    "frames": "frames a second of /vss/snap on a running machine, through each renderer",
    "coverage": "how often the truth is in the 95 % regions stated, from the calibration of the cameras on",
    "services": "each Service's answers a second on a running machine, one client and several; where the time goes",
}

_DESCRIPTION = """Measures the Vision Services System, at clock factor 0. Frames a second are also given over those of
pybullet's bare getCameraImage of the same size and renderer, measured in the same run; an image of which nothing moved
is not rendered anew. All figures are written as JSON into results/ too. What else runs on the computer shows: the load
average is printed before and after.

parts:
""" + "\n".join(f"  {name:10} {what}" for name, what in PARTS.items())


def main() -> int:
    """Run the command.

    Returns:
        Exit code: 0 all bars are met, 1 a bar is missed or a measurement failed, 2 bad usage, 130 interrupted.
    """
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="bench --vss", description=_DESCRIPTION, formatter_class=raw)
    parser.add_argument("parts", nargs="*", metavar="PART", help="only these (all)")
    parser.add_argument("--renderer", choices=cameras.RENDERERS, help="only this one (both)")
    options = parser.parse_args()
    unknown = [part for part in options.parts if part not in PARTS]
    if unknown:
        parser.error(f"there is no part '{unknown[0]}'; there are {', '.join(PARTS)}")
    try:
        lines, failed = measure(_work(options), options.parts or list(PARTS))
    except KeyboardInterrupt:
        print("bench: interrupted", file=sys.stderr)
        return 130
    return 0 if report("bench-vss", lines) and not failed else 1


def _work(options: argparse.Namespace) -> dict[str, Callable[[], list[Line]]]:
    """What measures each part."""
    renderers = (options.renderer,) if options.renderer else cameras.RENDERERS
    return {
        "cameras": lambda: [line for name in renderers for line in _or_why(name, partial(cameras.lines, name))],
        "frames": lambda: [line for name in renderers for line in _or_why(name, partial(_frames, name))],
        "coverage": coverage.lines,
        "services": lambda: _machine_lines("services", options.renderer or "auto"),
    }


def _frames(renderer: str) -> list[Line]:
    """Frames a second of the machine over those of the bare renderer."""
    (bare,) = cameras.lines(renderer, only_bare=True)
    return [
        replace(line, baseline=bare.value, against="bare") if line.unit == "1/s" else line
        for line in (bare, *_machine_lines("frames", renderer))
    ]


def _or_why(renderer: str, work: Callable[[], list[Line]]) -> list[Line]:
    """Lines of a renderer, or one that says why there are none."""
    try:
        return work()
    except ImError as error:
        return [Line(renderer, None, "", None, error.message)]


def _machine_lines(part: str, renderer: str) -> list[Line]:
    """What the bench of the whole machine says.

    Raises:
        ImError: It failed.
    """
    return measured_by_machine("--vision", part, "--renderer", renderer)


if __name__ == "__main__":
    sys.exit(main())
