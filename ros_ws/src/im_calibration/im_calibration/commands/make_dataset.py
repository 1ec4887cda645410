"""``make_dataset text|opencv|bag ... OUT.json``: a data set for ``calibrate_dataset`` from files of others."""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from im_calibration.commands import command
from im_calibration.commands.images import UNITS, named
from im_calibration.problem.bags import BagTopics, dataset_from_bag
from im_calibration.problem.convert import BoardSighting, dataset_from, dataset_from_boards, read_lines, read_opencv
from im_calibration.problem.dataset import problems
from im_core.errors import DataError
from im_core.files import is_same, write_whole

_READERS = {"text": read_lines, "opencv": read_opencv}

_EPILOG = """\
text    lines  u v x y z  of one camera: where it saw a point [px], and where that point was [--unit], in one frame that
        does not move, nor the camera. Blanks, tabs, commas or semicolons between; # begins a comment.
opencv  a YAML file of cv::FileStorage with the matrices image_points (n x 2) and object_points (n x 3), and image_width
        and image_height where --image-size is not given. Or views of a chessboard, as OpenCV's own sample of a
        calibration writes them: a row of image_points each, with board_width, board_height and square_size [--unit].
bag     a rosbag2, MCAP or SQLite: spots as geometry_msgs/PointStamped, x and y in pixels, stamped as their images, and
        poses; `make_dataset bag --help` says more.

Points of several cameras in text or opencv files belong together where x, y and z are the same to the last digit. The
centre of the upper left pixel is (0, 0): of files that count from 1, or from the corner of the image, only the
principal point is off. Noise that is not given is null in OUT.json, and calibrate_dataset estimates it. A calibration
block or a board is --sigma-position 0, or as exact as it was made; a robot is as good as its repeatability.

exit codes: 0 OUT.json is written; 1 a file cannot be used (file and line are named); 2 wrong arguments; 130 interrupted

examples: scripts/run.sh im_calibration make_dataset text cam=block.txt block.json --image-size 1280x1024 --unit mm
          scripts/run.sh im_calibration make_dataset opencv left=l.yml right=r.yml pair.json --sigma-px 0.2
          scripts/run.sh im_calibration make_dataset bag bags/demo demo.json --spots wall=/wall/spot --poses /tf \\
              --frames world left_led
          scripts/run.sh im_calibration calibrate_dataset block.json cameras.json
"""

_BAG_EPILOG = """\
Each spot goes with the pose whose stamp is nearest, spots of several cameras within --tolerance with the same one; a
spot that has none within it is left out, and how many are is said. Where no message of a topic is stamped, the times of
recording count. One spot a pose is best: the robot at rest has one error, however often it is looked at.

--poses is a topic of
  geometry_msgs/PoseStamped   the tool in the base of the robot, the light at --led-offset in it
  geometry_msgs/PointStamped  the light itself
  tf2_msgs/TFMessage          with --frames BASE TOOL: the tool, by the transforms up to the base, and /tf_static

Image size and lens model come from sensor_msgs/CameraInfo beside the spots, /NAME/camera_info for /NAME/spot, or on
--camera-info; the focal length is estimated, not taken.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, by default with the arguments of the process; return the exit code."""
    parser = command.parser("make_dataset", "Make a data set of what cameras saw of points at known places.", _EPILOG)
    formats = parser.add_subparsers(dest="format", required=True, metavar="{text,opencv,bag}")
    for name in _READERS:
        files = formats.add_parser(name, description=f"Make a data set from {name} files.")
        files.add_argument("cameras", nargs="+", type=named, metavar="CAMERA=FILE", help="camera and its file")
        files.add_argument("--unit", choices=sorted(UNITS), default="m", help="unit of the positions (%(default)s)")
        _add_common(files, "--unit")
    bag = formats.add_parser(
        "bag",
        description="Make a data set from a bag.",
        epilog=_BAG_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_bag(bag)
    _add_common(bag, "m")
    return command.run("make_dataset", lambda: _convert(parser.parse_args(arguments)))


def _add_common(parser: argparse.ArgumentParser, unit: str) -> None:
    parser.add_argument("output", type=Path, metavar="OUT.json", help="data set to write; on failure nothing")
    parser.add_argument("--image-size", type=_size, metavar="WIDTHxHEIGHT", help="size of the images [px]")
    parser.add_argument("--sigma-px", type=_positive, help="noise of each image coordinate [px] (default: unknown)")
    parser.add_argument(
        "--sigma-position", type=_not_negative, help=f"noise of each coordinate [{unit}]; 0: exact (default: unknown)"
    )


def _add_bag(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag, or its one file")
    a_topic: Any = {"nargs": "+", "type": named, "metavar": "CAMERA=TOPIC"}
    parser.add_argument("--spots", required=True, help="camera and the topic of its spots", **a_topic)
    parser.add_argument("--poses", required=True, metavar="TOPIC", help="poses of the tool, or of the light")
    parser.add_argument("--frames", nargs=2, metavar=("BASE", "TOOL"), help="frames of transforms on --poses")
    parser.add_argument("--camera-info", default=[], help="camera infos (default: beside the spots)", **a_topic)
    parser.add_argument("--led-offset", nargs=3, type=float, metavar=("X", "Y", "Z"), help="LED in the tool frame [m]")
    parser.add_argument("--led-offset-sd", type=_positive, help="its deviation, each axis [m] (default: exact)")
    parser.add_argument("--tolerance", type=_positive, default=0.02, help="largest gap of stamps [s] (%(default)s)")


def _convert(options: argparse.Namespace) -> None:
    target = options.output
    if "=" in target.name:
        raise DataError(f"{target}: the file to write comes last; this names a camera.", file=str(target))
    for _, file in getattr(options, "cameras", ()):
        if is_same(target, file):
            raise DataError(f"{target}: it is one of the files that are read.", file=str(target))
    content, remark = _from_bag(options) if options.format == "bag" else _from_files(options)
    (problem,) = problems(content)
    try:
        write_whole(target, json.dumps(content, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise DataError(f"{target}: {error.strerror}.", file=str(target)) from error
    counts = zip(problem.camera_names, problem.detected.sum(axis=1), strict=True)
    told = [f"{len(problem.positions)} positions", *(f"{count} spots of {name}" for name, count in counts)]
    unknown = " and ".join(problem.noise_to_estimate)
    print(f"{target}: {', '.join(told)}" + (f"; {unknown} noise not known" if unknown else "") + remark)


def _from_files(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    metres = UNITS[options.unit]
    read = _READERS[options.format]
    sightings = {name: read(Path(path)) for name, path in _once(options.cameras).items()}
    boards = {name: each for name, each in sightings.items() if isinstance(each, BoardSighting)}
    points = {name: each for name, each in sightings.items() if not isinstance(each, BoardSighting)}
    if boards and points:
        raise DataError(f"{', '.join(boards)} has views of a board, {', '.join(points)} has points at known places.")
    if boards:
        return dataset_from_boards(boards, options.image_size, metres, options.sigma_px), ""
    sigma_m = None if options.sigma_position is None else metres * options.sigma_position
    return dataset_from(points, options.image_size, metres, options.sigma_px, sigma_m), ""


def _from_bag(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Return the data set, and a text on the pairing of the spots."""
    spots, infos = _once(options.spots), _once(options.camera_info)
    if foreign := infos.keys() - spots.keys():
        raise DataError(f"--camera-info names {', '.join(sorted(foreign))}, --spots {', '.join(spots)}.")
    offset = None if options.led_offset is None else np.array(options.led_offset)
    if offset is not None and not np.all(np.abs(offset) < math.inf):
        raise DataError("--led-offset has a number that is not finite.")
    made = dataset_from_bag(
        options.bag,
        BagTopics(spots, options.poses, tuple(options.frames) if options.frames else None, infos),
        tolerance_s=options.tolerance,
        led_offset=offset,
        led_offset_sd=options.led_offset_sd,
        image_size=options.image_size,
        sigma_px=options.sigma_px,
        sigma_m=options.sigma_position,
    )
    apart, left_out = 1e3 * made.pairing.apart_s, made.pairing.left_out
    moved = f"in which the light moved {1e3 * made.moved_m:.2g} mm"
    remark = f"\nspots and their poses are at most {apart:.3g} ms apart, {moved}"
    remark += f"; {left_out} spots without a pose of their own are left out" if left_out else ""
    for name, lens in made.lenses.items():
        remark += f"\n{name} has a lens of model '{lens}', of which nothing is known here; plumb_bob is taken for it"
    return made.content, remark


def _once(named: list[tuple[str, str]]) -> dict[str, str]:
    if len(dict(named)) != len(named):
        raise DataError("Each camera may be given once.")
    return dict(named)


def _size(text: str) -> tuple[int, int]:
    width, times, height = text.partition("x")
    if not (times and width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"'{text}' is not WIDTHxHEIGHT, such as 1280x1024")
    return int(width), int(height)


def _positive(text: str) -> float:
    return _number(text, zero=False)


def _not_negative(text: str) -> float:
    return _number(text, zero=True)


def _number(text: str, *, zero: bool) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not (0.0 < value < 1e6 or (zero and value == 0.0)):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number {'>= 0' if zero else '> 0'}")
    return value


if __name__ == "__main__":
    sys.exit(main())
