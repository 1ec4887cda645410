"""``calibrate_dataset IN.json OUT.json``: calibrate the cameras of each trial of a data set.

``calibrate_dataset --again FOLDER``, or ``im calibrate --again FOLDER``: those of a folder of results once more.
``im calibrate --images CAMERA=FOLDER ... --target TARGET --results FOLDER``: from images of a target, or with ``--bag``
or ``--seconds`` of its images on topics.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from im_calibration.commands import command
from im_calibration.commands.images import add_images, check_images, problem_of_images
from im_calibration.problem.dataset import load_problems
from im_calibration.problem.problem import NOISE_SOURCES, CalibrationProblem
from im_calibration.reporting.report import answer
from im_calibration.reporting.results import OBSERVATIONS, write_results
from im_calibration.selection import calibrate_possible
from im_calibration.targets.views import ShownViews
from im_cell.calibration_files import CameraPose
from im_cell.lens import LENSES
from im_core.clock import monotonic
from im_core.errors import DataError
from im_core.files import is_same, write_whole

_QUIET_S = 2.0

_EPILOG = """\
IN.json (format vislab-calib-1, field by field in docs/calibration.md) holds, for n poses of the robot and c cameras:
  image_size [w, h], or [[w, h], ...], one a camera
  distortion_model: plumb_bob, rational_polynomial or equidistant, or a list of one a camera
  sigma_u_px[c][n] [px], or cov_u_px2[c][n][2][2] [px^2]     noise of the spots; null: not known, estimate it
  cov_x_m2[n][3][3] [m^2]                                    noise of the positions; null: not known, estimate it
  wrist_R_base[n][3][3], led_offset_nominal_known, led_offset_prior_sd_m [m]
  J_joint[n][3][k], joint_offset_prior_sd_rad [rad]          where joint offsets are to be estimated
  J_arm[n][3][m] [m]                                         errors of the arm's kinematics, each of its usual size
  trials[].x_base_m[n][3] [m]    trials[].u_px[c][n] = [u, v] [px], or null where the LED was not seen
  known_lengths.length_m[k], .sd_m[k] [m], .sigma_u_px[c][k] [px], trials[].length_u_px[c][k][2] [px] or null:
                                 two LEDs at a known distance, which show whether the robot's metre is right
Truth, held-out points and bounds that such a file may hold as well are not read; any other field is refused.

OUT.json holds an entry for each trial, in order:
  cameras[].K, distortion_model, D, R_cam_base, t_cam_base_m   led_offset_error_m   joint_offsets_rad
  chi2_per_dof   p_value
  flags: UNOBSERVABLE (the poses cannot tell some parameters; verdicts[] names them) and
         MISFIT (the stated noise cannot explain the residuals); both with what to do about it in verdicts[].advice
  noise: factors by which the noise of image and robot differs from the stated one (factor, low to high: 95 %), whether
         they can be told apart, what the estimate stands on, and a remark where the stated noise is wrong
  covariance of all parameters, outlier[c][n], checks, expected_error with its map, scale by the known lengths

--again FOLDER reads FOLDER/observations.json, as calibrate_camera leaves it also where it failed or was cancelled, and
writes into FOLDER/again what calibrate_camera writes: report, summary, pictures and camera files. Cameras that saw too
little are left out and named. Poses of cameras on an arm are in the world, as the arm stood.

exit codes: 0 the answers are written, whatever the flags; 1 a file cannot be used, and OUT.json is as before, or with
            --again there is no estimate of any camera; 2 wrong arguments; 130 interrupted

examples: scripts/im calibrate data.json cameras.json
          scripts/im calibrate --noise estimated data.json cameras.json
          scripts/im calibrate --again results/latest --lens-model rational_polynomial
          scripts/im calibrate --images left=images/left --target chessboard:9x6:25mm --results results/left
          scripts/im calibrate --bag bags/hand --camera left:=/left/image_raw --base base_link --tool tool0 \\
              --eye-in-hand --target chessboard:9x6:25mm --results results/hand
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, by default with the arguments of the process; return the exit code."""
    parser = command.parser(
        "calibrate_dataset", "Calibrate the cameras of each trial of a data set of wrist-LED observations.", _EPILOG
    )
    parser.add_argument("input", type=Path, nargs="?", metavar="IN.json", help="data set")
    parser.add_argument(
        "output", type=Path, nargs="?", metavar="OUT.json", help="answers to write; nothing is written on failure"
    )
    parser.add_argument("--again", type=Path, metavar="FOLDER", help="instead: folder of results of calibrate_camera")
    parser.add_argument(
        "--noise",
        choices=("stated", "estimated"),
        default="stated",
        help="estimated: scale the stated noise of image and robot by one factor each, and estimate the factors; noise "
        "that is null in IN.json is always estimated (%(default)s)",
    )
    parser.add_argument(
        "--lens-model",
        choices=tuple(LENSES),
        help="lens model of all cameras (default: distortion_model in IN.json, else plumb_bob)",
    )
    add_images(parser)
    options = parser.parse_args(arguments)
    if any((options.images, options.bag, options.camera, options.target, options.results, options.robot)):
        if wrong := check_images(options) or ("images stand alone" if options.again or options.input else ""):
            parser.error(wrong)
        return command.run("calibrate_dataset", lambda: _from_images(options))
    if (options.again is None) == (options.output is None) or (options.input is None) != (options.output is None):
        parser.error("IN.json and OUT.json are needed, or --again FOLDER alone")
    return command.run("calibrate_dataset", lambda: _again(options) if options.again else _calibrate(options))


def _problems(source: Path, options: argparse.Namespace) -> tuple[CalibrationProblem, ...]:
    problems = load_problems(source)
    if (lens := options.lens_model) is not None:
        problems = tuple(replace(problem, lens_models=(lens,) * len(problem.camera_names)) for problem in problems)
    if options.noise == "estimated":
        problems = tuple(replace(problem, noise_to_estimate=NOISE_SOURCES) for problem in problems)
    return problems


def _again(options: argparse.Namespace) -> None:
    problem, target = _problems(options.again / OBSERVATIONS, options)[0], options.again / "again"
    for name in problem.camera_names:
        if Path(name).name != name:  # it becomes that of a file
            raise DataError(f"{options.again / OBSERVATIONS}: camera_names has {name!r}, which is no name of a file.")
    _write(target, problem)


def _from_images(options: argparse.Namespace) -> None:
    problem, seen = problem_of_images(options)
    print("\n".join(seen.told))
    _write(options.results, problem, seen.shown)


def _write(target: Path, problem: CalibrationProblem, shown: ShownViews | None = None) -> None:
    calibration = calibrate_possible(problem)
    poses = None
    if (placements := problem.placements) is not None:
        frame = "link" if placements.camera_moves else "base" if placements.held is None else problem.camera_names[0]
        poses = {camera.name: CameraPose.of(frame, camera.model) for camera in calibration.cameras}
    write_results(target, calibration, problem, poses, shown=shown)
    print(f"{target}: {calibration.message}")


def _calibrate(options: argparse.Namespace) -> None:
    source, target = options.input, options.output
    problems = _problems(source, options)
    if target.is_dir() or not target.parent.is_dir():
        raise DataError(f"{target}: a file in an existing directory is needed.", file=str(target))
    if is_same(target, source):
        raise DataError(f"{target}: the answers would replace the data set; name another file.", file=str(target))
    begin = told = monotonic()
    trials = []
    for i, problem in enumerate(problems):
        trials.append(answer(problem))
        if monotonic() - told > _QUIET_S:
            told = monotonic()
            print(f"{i + 1} of {len(problems)} trials, {told - begin:.0f} s", file=sys.stderr, flush=True)
    try:
        write_whole(target, json.dumps({"trials": trials}, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise DataError(f"{target}: {error.strerror}.", file=str(target)) from error
    for i, trial in enumerate(trials):
        print(f"trial {i}: {trial['message']}")


if __name__ == "__main__":
    sys.exit(main())
