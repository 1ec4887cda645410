"""``replay.sh BAG --recalibrate``: a calibration again from a bag, without a machine, beside the recorded result."""

import argparse
import contextlib
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from im_bag.command_line import parsed
from im_bag.reading import messages_of, topics_of
from im_calibration import (
    SAME,
    CalibrationProblem,
    DegenerateDataError,
    InconsistentDataError,
    calibrate_possible,
    comparison,
    largest_difference,
    report_of,
    write_observations,
)
from im_calibration.problem.bags import RecordedCalibration, recorded_calibrations, recorded_sizes
from im_calibration.problem.problem import NOISE_SOURCES
from im_calibration.recorded.stamps import stamp_of
from im_cell.lens import LENSES
from im_cell.robot import Cell, load_cell
from im_core import clock
from im_core.errors import DataError, ImError, StateError
from im_core.names import results_dir
from im_vss.camera_book import CameraBook
from im_vss.camera_poses import Pose, at_rest
from im_vss.recalibration import find_again
from im_vss.ros.light_tracker import wrist_by
from im_vss.ros.ports.calibration import from_request
from im_vss.services.calibrate import (
    CalibrateRequest,
    Mount,
    dataset_and_problem,
    on_their_mounts,
    write_calibration,
)
from im_vss.settings import VssSettings, load_settings

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
_QUIET_S = 2.0

_EPILOG = """\
With the options of the recorded command the numbers are the same to 1e-9 (relative; those of a list, to its largest).
With others it is a new calibration; the table shows both. Report, pictures and camera files are written as the command
writes them. Spots in images are looked for with the settings of this workspace (vss.yaml), where the look was made.

exit codes: 0 calibrated, and the same where nothing was changed; 1 it is not the same, there is no estimate, or a
            verdict against it that the recorded one has not; 2 wrong arguments, no such bag, no calibration in it;
            130 interrupted
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, by default with the arguments of the process; return the exit code."""
    options = parsed(_parser(), arguments)
    try:
        return _recalibrate(options)
    except (DegenerateDataError, InconsistentDataError) as error:
        print(f"replay: there is no estimate: {error.message}", file=sys.stderr)
        return FAILED
    except ImError as error:
        print(f"replay: {error.message}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("replay: interrupted", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="replay",
        description="Compute a calibration of a bag again, without a machine.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, help="folder of the bag, or a file of it")
    parser.add_argument("--recalibrate", action="store_true", required=True, help="instead of publishing the messages")
    parser.add_argument(
        "--from",
        dest="source",
        choices=("spots", "images"),
        default="spots",
        help="the spots that were found then, or those that are found in the recorded images now (%(default)s)",
    )
    parser.add_argument("--cameras", nargs="+", metavar="CAMERA", help="only these of the recorded ones")
    parser.add_argument("--lens-model", choices=tuple(LENSES), help="of all cameras (the command's: plumb_bob)")
    parser.add_argument(
        "--noise",
        choices=("stated", "estimated"),
        default="stated",
        help="estimated: noise of image and robot are right up to a factor each, which is estimated (%(default)s)",
    )
    parser.add_argument("--number", type=int, metavar="N", help="the N-th calibration of the bag (the last)")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="DIR", help="where the results go (results/<date>-<time>-recalibrated)"
    )
    return parser


def _recalibrate(options: argparse.Namespace) -> int:
    directory = _folder(options)
    call = _chosen(options)
    cell = load_cell()
    settings = load_settings(cell)
    request = _narrowed(from_request(call.request), options, settings)
    changed = options.source == "images" or options.lens_model or options.noise == "estimated"
    changed = bool(changed or request.cameras != tuple(call.request.cameras))
    if options.source == "images":
        if request.target:
            raise DataError(f"{options.bag}: a board is not looked for again in images, take --from spots")
        request, found = find_again(options.bag, call, request, settings, _progress())
        print(f"replay: {found}")
    dataset, problem = _problem(options, call, request, cell, settings)
    calibration = calibrate_possible(problem)
    book = CameraBook(cell, settings.cameras, directory, settings.stereo.pairs or ())
    mount = mount_in(options.bag, call.logged_ns, cell, settings.region.freshness * 1e9)
    mounted, covariance = on_their_mounts(calibration, request, book, mount)
    write_observations(directory, dataset)
    write_calibration(directory, calibration, problem, book, mounted, covariance)
    print(f"replay: {calibration.message}")
    code = _compared(call, json.loads(json.dumps(report_of(calibration, problem))), changed)
    print(f"replay: {directory}")
    return code


def _chosen(options: argparse.Namespace) -> RecordedCalibration:
    calls = recorded_calibrations(options.bag)
    number = len(calls) if options.number is None else options.number
    if not 1 <= number <= len(calls):
        raise DataError(f"{options.bag}: it holds the calibrations 1 to {len(calls)}, --number is {number}")
    call = calls[number - 1]
    poses, cameras = len(call.request.observations), ", ".join(call.request.cameras)
    which = f"calibration {number} of {len(calls)}" if len(calls) > 1 else "the calibration of the bag"
    print(f"replay: {which}: {cameras}; {poses} poses")
    return call


def _narrowed(request: CalibrateRequest, options: argparse.Namespace, settings: VssSettings) -> CalibrateRequest:
    """The request for the cameras of interest.

    Raises:
        ImError: One is not in the bag, not in the cell, or given twice.
    """
    cameras = request.cameras if options.cameras is None else tuple(options.cameras)
    for camera in cameras:
        if camera not in request.cameras:
            known = ", ".join(request.cameras)
            raise DataError(f"{options.bag}: {camera} was not calibrated in it; there are {known}", camera=camera)
    return replace(request, cameras=settings.check_cameras(cameras))


def _problem(
    options: argparse.Namespace,
    call: RecordedCalibration,
    request: CalibrateRequest,
    cell: Cell,
    settings: VssSettings,
) -> tuple[dict[str, Any], CalibrationProblem]:
    """Return the data set and the problem of a request.

    Raises:
        ImError: The observations are malformed, their board is not in the cell, or the bag does not tell all of them.
    """
    offset = call.led_offset()
    if offset is None and not request.target:
        told = f"{[1e3 * value for value in cell.led.offset]} mm, each axis to {1e3 * cell.led.offset_prior_sd:g} mm"
        print(f"replay: the bag does not tell where the light is in the wrist; as this workspace has it: {told}")
    return dataset_and_problem(
        request,
        recorded_sizes(options.bag, call, request.cameras),
        cell,
        settings.cameras,
        offset=offset,
        lens_model=options.lens_model,
        noise_to_estimate=NOISE_SOURCES if options.noise == "estimated" else (),
    )


def _folder(options: argparse.Namespace) -> Path:
    """Where the results go.

    Raises:
        DataError: There is something.
    """
    directory: Path = options.output or results_dir() / f"{clock.stamp_name()}-recalibrated"
    if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
        raise DataError(f"{directory}: it exists and is not empty; name another folder with -o", file=str(directory))
    return directory


def mount_in(bag: Path, until_ns: int, cell: Cell, freshness_ns: float) -> Mount:
    """Return where wrists were at exposures, by the transforms of a bag.

    Args:
        bag: The bag.
        until_ns: Time of recording after which transforms are too late [ns]: the testbed's time may begin again.
        cell: Nominal geometry.
        freshness_ns: How far the stamps of transforms may be from an exposure [ns].
    """

    def mount(frame: str, stamps_ns: Sequence[int]) -> Pose:
        if "/tf" not in topics_of(bag):
            raise StateError(f"{bag}: a camera is fixed to {frame}, and no transforms say where that was")
        found = dict[int, Pose]()
        for message in messages_of(bag, {"/tf": ("tf2_msgs/msg/TFMessage",)}):
            if message.logged_ns > until_ns:
                break
            told = {stamp_of(each.header) for each in message.content.transforms}
            for stamp in stamps_ns:
                if any(abs(stamp - when) <= freshness_ns for when in told):
                    with contextlib.suppress(DataError):  # not from MCS
                        found[stamp] = wrist_by(message.content, cell, frame, stamp, freshness_ns)
        return at_rest(frame, [found[stamp] for stamp in stamps_ns if stamp in found])

    return mount


def _compared(call: RecordedCalibration, report: dict[str, Any], changed: bool) -> int:
    """Print the recorded result beside the new one; return the exit code."""
    if call.report is None:
        print(f"replay: the bag holds no estimate to compare with: {call.refusal or 'no answer was recorded'}")
        return OK if report["success"] else FAILED
    try:
        rows = comparison(call.report, report)
    except (LookupError, TypeError, ValueError, DataError) as error:  # of another version, or another's
        print(f"replay: the recorded report cannot be compared, it is none of this version: {error!r}")
        return OK if report["success"] else FAILED
    print("\n".join(rows))
    if changed:
        return OK if report["success"] or not call.report.get("success") else FAILED
    difference, where = largest_difference(call.report, report)
    if difference <= SAME:
        print(f"replay: the same numbers as recorded (largest relative difference {difference:.2g})")
        return OK
    print(f"replay: NOT the same numbers as recorded: {where} differs by {difference:.3g} (relative)")
    return FAILED


def _progress() -> Callable[[str], None]:
    """Return a reporter of progress, every 2 s."""
    told = [clock.monotonic()]

    def tell(text: str) -> None:
        if clock.monotonic() - told[0] > _QUIET_S:
            told[0] = clock.monotonic()
            print(f"replay: {text}", file=sys.stderr, flush=True)

    return tell


if __name__ == "__main__":
    sys.exit(main())
