"""``python -m bench.calibration``: how good the calibration is, on synthetic data with known truth."""

import argparse
import sys
from collections.abc import Sequence

from bench.calibration.further_poses import further_poses
from bench.calibration.kinds import CLEAN, HARD
from bench.calibration.noise import DESIGNS, TRUE_FACTORS, wrong_noise
from bench.calibration.score import score
from bench.calibration.verdicts import false_verdicts, wrong_verdicts

_BAD, _GOOD = 60, 500

_EPILOG = """\
errors    errors of each kind of data over the Cramer-Rao bound of the inliers, over the best of OpenCV's
          calibrateCamera (plain, and after RANSAC and trimming), and that best over the bound: reprojection /
          triangulation; the least, mean and largest share over the parameters of 95 % intervals that hold the truth
verdicts  60 bad data sets with a wrong verdict, 500 good ones with any
noise     data whose noise is not as stated, by factors on image and robot: share of 95 % intervals of both factors that
          hold the true ones, share of trials that tell them apart, and least, mean and largest share over the
          parameters of scaled 95 % intervals that hold the truth
poses     errors achieved with further poses by expected error, and by chance
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.calibration",
        description="How good the calibration is, on synthetic data with known truth.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("what", nargs="?", choices=("errors", "verdicts", "noise", "poses"), default="errors")
    parser.add_argument("--trials", type=int, default=20, help="trials of each kind, or of poses (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first (%(default)s)")
    parser.add_argument("--kind", default="", help="only kinds whose name holds this text (errors, noise)")
    options = parser.parse_args(arguments)
    if options.what == "errors":
        _errors(range(options.seed, options.seed + options.trials), options.kind)
    elif options.what == "noise":
        _noise(range(options.seed, options.seed + options.trials), options.kind)
    elif options.what == "verdicts":
        _verdicts(options.seed)
    else:
        found = further_poses(range(options.seed, options.seed + options.trials))
        print(
            f"triangulation error with 12 poses {found.before:.3f} mm, with 6 chosen more {found.chosen:.3f} mm "
            f"({found.predicted:.3f} mm predicted), with 6 random more {found.random:.3f} mm"
        )
    return 0


def _errors(seeds: range, kind: str) -> None:
    print(
        f"{'kind':<30} {'over the bound':>15} {'over OpenCV':>15} {'OpenCV / bound':>17}   "
        "coverage (least, mean, most)   verdicts"
    )
    for name, design in (CLEAN | HARD).items():
        if kind not in name:
            continue
        found = score(design, seeds)
        theirs = tuple(b / o for b, o in zip(found.to_bound, found.to_opencv, strict=True))
        bound, opencv, limit = (f"{a:.3f} / {b:.3f}" for a, b in (found.to_bound, found.to_opencv, theirs))
        covered = found.coverage
        spread = f"{covered.min():.3f} {covered.mean():.3f} {covered.max():.3f}"
        print(f"{name:<30} {bound:>15} {opencv:>15} {limit:>17}   {spread:<28}   {found.verdicts}", flush=True)


def _noise(seeds: range, kind: str) -> None:
    print(
        f"{'kind':<22} {'image':>6} {'robot':>6}   held: image robot   apart   coverage (least, mean, most)   verdicts"
    )
    for name, design in DESIGNS.items():
        if kind not in name:
            continue
        for image, robot in TRUE_FACTORS:
            found = wrong_noise(design, (image, robot), seeds)
            covered = found.coverage
            spread = f"{covered.min():.3f} {covered.mean():.3f} {covered.max():.3f}"
            held = f"{found.image:>11.3f} {found.robot:.3f}"
            apart = f"{found.separable:>7.2f}"
            print(f"{name:<22} {image:>6} {robot:>6} {held} {apart}   {spread:<28} {found.verdicts:>8}", flush=True)


def _verdicts(seed: int) -> None:
    for title, found, count in (
        ("bad", wrong_verdicts(seed, _BAD), _BAD),
        ("good", false_verdicts(seed, _GOOD), _GOOD),
    ):
        wrong = 0
        for name, at, flags in found:
            wrong += 1
            print(f"{title} set, {name}, seed {at}: {', '.join(flags) or 'no verdict'}", flush=True)
        print(f"{wrong} of {count} {title} sets got a wrong verdict", flush=True)


if __name__ == "__main__":
    sys.exit(main())
