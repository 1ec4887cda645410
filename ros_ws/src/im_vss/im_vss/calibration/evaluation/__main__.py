"""``python -m im_vss.calibration.evaluation``: the table of how good the calibration is, kind by kind."""

import argparse
import sys
from collections.abc import Sequence

from im_vss.calibration.evaluation.kinds import CLEAN, HARD
from im_vss.calibration.evaluation.score import score


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line a kind."""
    parser = argparse.ArgumentParser(
        prog="python -m im_vss.calibration.evaluation",
        description="Errors of the calibration on synthetic data: over the Cramer-Rao bound of the inliers, and over "
        "the best of OpenCV's calibrateCamera (plain, and after RANSAC and trimming). Reprojection / triangulation.",
    )
    parser.add_argument("--trials", type=int, default=20, help="trials of each kind (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first (%(default)s)")
    parser.add_argument("--kind", default="", help="only kinds whose name holds this text")
    options = parser.parse_args(arguments)
    print(f"{'kind':<30} {'over the bound':>15} {'over OpenCV':>15}   coverage (least, mean, most)   verdicts")
    for name, design in (CLEAN | HARD).items():
        if options.kind not in name:
            continue
        found = score(design, range(options.seed, options.seed + options.trials))
        bound, opencv = (f"{a:.3f} / {b:.3f}" for a, b in (found.to_bound, found.to_opencv))
        covered = found.coverage
        spread = f"{covered.min():.3f} {covered.mean():.3f} {covered.max():.3f}"
        print(f"{name:<30} {bound:>15} {opencv:>15}   {spread:<28}   {found.verdicts}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
