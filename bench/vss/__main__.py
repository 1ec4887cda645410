"""``python -m bench.vss``: the figures of VSS; for ``scripts/bench.sh --vss``."""

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from bench.figures import Line, measured_by_machine
from bench.part import Part, Work
from bench.vss import cameras, coverage
from im_core.errors import ImError

GROUPS = {
    "cameras": "frames a second of the simulated cameras alone, through each renderer, and the steps of a frame",
    "frames": "frames a second of /vss/snap on a running machine, through each renderer",
    "coverage": "how often the truth is in the 95 % regions stated, from the calibration of the cameras on",
    "services": "each Service's answers a second on a running machine, one client and several; where the time goes",
}

_ABOUT = """Measures the Vision Services System, at clock factor 0. Frames a second are also given over those of
pybullet's bare getCameraImage of the same size and renderer, measured in the same run; an image of which nothing moved
is not rendered anew. All figures are written as JSON into results/ too. What else runs on the computer shows: the load
average is printed before and after."""


def main() -> int:
    """Run the command; its exit code."""
    part = Part("vss", _ABOUT, GROUPS)
    part.parser.add_argument("--renderer", choices=cameras.RENDERERS, help="only this one (both)")
    return part.run(_work)


def _work(options: argparse.Namespace, _: Path) -> Work:
    """What measures each group."""
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


def _machine_lines(group: str, renderer: str) -> list[Line]:
    """What the bench of the whole machine says.

    Raises:
        ImError: It failed.
    """
    return measured_by_machine(group, "--renderer", renderer)


if __name__ == "__main__":
    sys.exit(main())
