"""``python -m bench.calibration``: how good the calibration is, on synthetic data with known truth."""

import argparse
import math
import sys
from pathlib import Path

from bench.calibration.further_poses import further_poses
from bench.calibration.kinds import CLEAN, HARD
from bench.calibration.noise import DESIGNS, TRUE_FACTORS, wrong_noise
from bench.calibration.score import Array, Score, score
from bench.calibration.synthetic import Design
from bench.calibration.verdicts import false_verdicts, wrong_verdicts
from bench.figures import Line
from bench.part import Part, Work, positive

GROUPS = {
    "errors": "of each kind of data, over the Cramer-Rao bound of the inliers and over OpenCV; coverage",
    "verdicts": "60 bad data sets with a wrong verdict, 500 good ones with any",
    "noise": "data whose noise is not as stated: whether its factors are found; coverage of scaled intervals",
    "poses": "errors achieved with further poses by expected error, and by chance",
}
USUAL = ("errors",)

_BAD, _GOOD = 60, 500
_BARS = ((CLEAN, 1.03), (HARD, 0.9))
"""Kinds of data with the most that errors over OpenCV's may be."""

_ABOUT = """How good the calibration is, on synthetic data with known truth. OpenCV's calibrateCamera is taken at its
best: plain, or after RANSAC and trimming. Coverage is the share of trials whose 95 % interval holds the truth, of the
parameter for which it is least, of all on average, and of that for which it is most. Few trials tell little of it."""


def main() -> int:
    """Run the command; its exit code."""
    part = Part("calibration", _ABOUT, GROUPS, USUAL)
    add = part.parser.add_argument
    add("--trials", type=positive(int), default=20, help="of each kind, or of poses (default: %(default)d)")
    add("--seed", type=int, default=1, help="of the first trial (default: %(default)d)")
    add("--kind", default="", help="only kinds whose name holds this text (errors, noise)")
    return part.run(_work)


def _work(options: argparse.Namespace, _: Path) -> Work:
    """What measures each group."""
    seeds = range(options.seed, options.seed + options.trials)
    return {
        "errors": lambda: _errors(seeds, options.kind),
        "verdicts": lambda: _verdicts(options.seed),
        "noise": lambda: _noise(seeds, options.kind),
        "poses": lambda: _poses(seeds),
    }


def _errors(seeds: range, kind: str) -> list[Line]:
    found: list[Line] = []
    for designs, bar in _BARS:
        for name, design in designs.items():
            if kind in name:
                found += _kind(name, design, seeds, bar)
    return found


def _kind(name: str, design: Design, seeds: range, bar: float) -> list[Line]:
    print(f"bench: {name}, {len(seeds)} trials", flush=True)
    found: Score = score(design, seeds)
    lines = []
    for number, error in enumerate(("reprojection", "triangulation")):
        if not math.isnan(found.to_bound[number]):  # one camera triangulates nothing
            lines.append(Line(f"{name}: {error} error, over the bound", found.to_bound[number], ""))
            lines.append(Line("  over the best of OpenCV", found.to_opencv[number], "", bar=bar))
    return [*lines, *_coverage(found.coverage), Line("  trials with a verdict", found.verdicts, "")]


def _noise(seeds: range, kind: str) -> list[Line]:
    lines: list[Line] = []
    for name, design in DESIGNS.items():
        for image, robot in TRUE_FACTORS if kind in name else ():
            print(f"bench: {name}, noise times {image:g} and {robot:g}", flush=True)
            found = wrong_noise(design, (image, robot), seeds)
            lines += [
                Line(f"{name}, noise {image:g} and {robot:g} times: image's held", found.image, ""),
                Line("  robot's held", found.robot, ""),
                Line("  told apart", found.separable, ""),
                *_coverage(found.coverage),
                Line("  trials with a verdict", found.verdicts, ""),
            ]
    return lines


def _coverage(covered: Array) -> list[Line]:
    shares = (("least", covered.min()), ("mean", covered.mean()), ("most", covered.max()))
    return [Line(f"  coverage of 95 % intervals, {which}", float(share), "") for which, share in shares]


def _verdicts(seed: int) -> list[Line]:
    lines = []
    for title, found, count in (
        ("bad", wrong_verdicts(seed, _BAD), _BAD),
        ("good", false_verdicts(seed, _GOOD), _GOOD),
    ):
        wrong = 0
        for name, at, flags in found:
            wrong += 1
            print(f"{title} set, {name}, seed {at}: {', '.join(flags) or 'no verdict'}", flush=True)
        lines.append(Line(f"{title} sets with a wrong verdict", wrong, "", None, f"of {count}"))
    return lines


def _poses(seeds: range) -> list[Line]:
    found = further_poses(seeds)
    return [
        Line("triangulation error with 12 poses", found.before, "mm"),
        Line("  with 6 chosen more", found.chosen, "mm", found.predicted, "predicted"),
        Line("  with 6 random more", found.random, "mm", found.chosen, "chosen"),
    ]


if __name__ == "__main__":
    sys.exit(main())
