"""``next_best_pose DATA.json POSES.yaml``: which further poses would improve the calibration of a data set most."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from im_calibration.commands import command
from im_calibration.design import NextPose, load_candidates, next_best_poses
from im_calibration.pipeline import calibrate
from im_calibration.problem.dataset import load_problems
from im_cell.robot import load_cell
from im_core.errors import DataError

_EPILOG = """\
DATA.json has the format vislab-calib-1 (calibrate_dataset --help); POSES.yaml holds the wrist poses to choose from:
  frame: world
  poses:
    - {name: p1, position_m: [x, y, z], orientation_xyzw: [x, y, z, w]}   # J_joint too, for joint offsets

Printed are the poses to measure, best first, each on top of those before it, and the expected errors over the
workspace (root mean square) before it and with it.

exit codes: 0 the poses are printed; 1 a file cannot be used, or the data give no cameras; 2 wrong arguments;
            130 interrupted

example:  scripts/run.sh im_mcs poses --count 200 --seed 7 --output poses.yaml
          scripts/run.sh im_calibration next_best_pose data.json poses.yaml --count 5
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, by default with the arguments of the process; return the exit code."""
    parser = command.parser(
        "next_best_pose",
        "Say which further poses would lower the expected errors of a calibration most, and how far.",
        _EPILOG,
    )
    parser.add_argument("data", type=Path, metavar="DATA.json", help="data set measured so far")
    parser.add_argument("poses", type=Path, metavar="POSES.yaml", help="poses to choose from")
    parser.add_argument("--trial", type=int, default=0, help="trial of the data set (%(default)s)")
    parser.add_argument("--count", type=int, default=1, help="number of poses to choose (%(default)s)")
    options = parser.parse_args(arguments)
    return command.run(
        "next_best_pose", lambda: _print(_choose(options.data, options.poses, options.trial, options.count))
    )


def _print(chosen: tuple[NextPose, ...]) -> None:
    print(f"{'pose':<12} {'reprojection [px]':>22} {'triangulation [mm]':>22}   seen by")
    for pose in chosen:
        errors = (f"{before:.4f} -> {after:.4f}" for before, after in (pose.reprojection_px, pose.triangulation_mm))
        print(f"{pose.name:<12} {' '.join(f'{text:>22}' for text in errors)}   {', '.join(pose.cameras)}")


def _choose(data: Path, poses: Path, trial: int, count: int) -> tuple[NextPose, ...]:
    problems = load_problems(data)
    if not 0 <= trial < len(problems):
        raise DataError(f"{data} has trials 0 to {len(problems) - 1}, there is no trial {trial}.", trial=trial)
    problem = replace(problems[trial], led_offset_nominal=load_cell().led.offset)
    calibration = calibrate(problem)
    if not calibration.success:  # the figures stand on the stated noise, and on what the data say now
        print(f"next_best_pose: doubtful, for the data are: {calibration.message}", file=sys.stderr)
    problem = problem.with_noise(*calibration.noise.scale)
    return next_best_poses(calibration, problem, load_candidates(poses, problem), count)


if __name__ == "__main__":
    sys.exit(main())
