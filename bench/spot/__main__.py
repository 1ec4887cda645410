"""``python -m bench.spot``: how well the light is found, with the shipped data sheet and gates."""

import argparse
import sys
from pathlib import Path

from bench.figures import Line
from bench.part import Part, Work, positive
from bench.spot.trials import count_false, score_spots
from im_cell.robot import load_cell
from im_vss.settings import load_settings

KINDS = {
    "faint": ((40.0, 90.0), (1.0, 1.4)),
    "usual": ((90.0, 170.0), (1.0, 1.6)),
    "wide": ((90.0, 170.0), (1.6, 2.6)),
    "saturated, few pixels": ((260.0, 400.0), (1.0, 1.5)),
    "saturated, many pixels": ((400.0, 1200.0), (1.0, 1.5)),
}
"""Peaks [DN] and widths [px] of the lights."""

GROUPS = {
    "found": "share of the lights that are found, errors over the Cramer-Rao bound, and over the stated covariance",
    "false": "spots that are found where there is no light",
}

_ABOUT = "Measures how well the light is found in an image, with the shipped data sheet and gates."


def main() -> int:
    """Run the command; its exit code."""
    part = Part("spot", _ABOUT, GROUPS)
    add = part.parser.add_argument
    add("--trials", type=positive(int), default=2000, help="spots of each kind (default: %(default)d)")
    add("--frames", type=positive(int), default=1000, help="pairs of frames without a light (default: %(default)d)")
    add("--seed", type=int, default=1, help="of what is drawn (default: %(default)d)")
    return part.run(_work)


def _work(options: argparse.Namespace, _: Path) -> Work:
    """What measures each group."""
    return {
        "found": lambda: _found(options.seed, options.trials),
        "false": lambda: _false(options.seed, options.frames),
    }


def _found(seed: int, trials: int) -> list[Line]:
    settings = load_settings(load_cell())
    lines = []
    for kind, (amplitude, sigma) in KINDS.items():
        score = score_spots(seed, trials, amplitude, sigma, settings.sensor, settings.spot)
        lines += [
            Line(f"{kind}: found, {trials} lights", 100.0 * score.found, "%"),
            Line("  RMS error of an axis", score.rms_px, "px", score.bound_px, "the Cramer-Rao bound"),
            Line("  mean squared error over that stated", score.nees, ""),
        ]
    return lines


def _false(seed: int, frames: int) -> list[Line]:
    settings = load_settings(load_cell())
    found = count_false(seed, frames, settings.sensor, settings.spot)
    return [Line("false spots", found, "", None, f"in {frames:,} pairs of frames without a light")]


if __name__ == "__main__":
    sys.exit(main())
