"""``python -m bench.spot``: prints how well the light is found, with the shipped data sheet and gates."""

import argparse
import sys

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


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="bench.spot", description=__doc__)
    parser.add_argument("--trials", type=int, default=2000, help="spots of each kind")
    parser.add_argument("--frames", type=int, default=1000, help="pairs of frames without a light")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    settings = load_settings(load_cell())
    print(f"{'lights':24s} {'found':>6s} {'RMS px':>8s} {'bound px':>9s} {'RMS/bound':>10s} {'NEES':>6s}")
    for kind, (amplitude, sigma) in KINDS.items():
        score = score_spots(arguments.seed, arguments.trials, amplitude, sigma, settings.sensor, settings.spot)
        numbers = f"{score.rms_px:8.4f} {score.bound_px:9.4f} {score.ratio:10.3f} {score.nees:6.2f}"
        print(f"{kind:24s} {score.found:6.1%} {numbers}")
    false = count_false(arguments.seed, arguments.frames, settings.sensor, settings.spot)
    print(f"false spots in {arguments.frames} pairs of frames without a light: {false}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
