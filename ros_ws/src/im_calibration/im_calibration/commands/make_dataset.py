"""``make_dataset text|opencv CAMERA=FILE... OUT.json``: a data set for ``calibrate_dataset`` from files of others."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from im_calibration.commands import command
from im_calibration.problem.convert import dataset_from, read_opencv, read_text
from im_calibration.problem.dataset import problems
from im_core.errors import DataError
from im_core.files import write_whole

_READERS = {"text": read_text, "opencv": read_opencv}
_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}

_EPILOG = """\
text    lines  u v x y z  of one camera: where it saw a point [px], and where that point was [--unit], in one frame that
        does not move, nor the camera. Blanks, tabs, commas or semicolons between; # begins a comment.
opencv  a YAML file of cv::FileStorage with the matrices image_points (n x 2) and object_points (n x 3), and image_width
        and image_height where --image-size is not given.

Points of several cameras belong together where x, y and z are the same to the last digit. The centre of the upper left
pixel is (0, 0): of files that count from 1, or from the corner of the image, only the principal point is off.
Noise that is not given is null in OUT.json, and calibrate_dataset estimates it. A calibration block or a board is
--sigma-position 0, or as exact as it was made; a robot is as good as its repeatability.

exit codes: 0 OUT.json is written; 1 a file cannot be used (file and line are named); 2 wrong arguments; 130 interrupted

examples: scripts/run.sh im_calibration make_dataset text cam=block.txt block.json --image-size 1280x1024 --unit mm
          scripts/run.sh im_calibration make_dataset opencv left=l.yml right=r.yml pair.json --sigma-px 0.2
          scripts/run.sh im_calibration calibrate_dataset block.json cameras.json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point.

    Args:
        arguments: Of the command line; None: those of the process.

    Returns:
        The exit code.
    """
    parser = command.parser("make_dataset", "Make a data set of what cameras saw of points at known places.", _EPILOG)
    parser.add_argument("format", choices=sorted(_READERS), help="what the files are")
    parser.add_argument("cameras", nargs="+", type=_camera, metavar="CAMERA=FILE", help="a name and its file")
    parser.add_argument("output", type=Path, metavar="OUT.json", help="the data set, whole or not at all")
    parser.add_argument("--image-size", type=_size, metavar="WIDTHxHEIGHT", help="of the images [px]")
    parser.add_argument("--unit", choices=sorted(_UNITS), default="m", help="of the positions (%(default)s)")
    parser.add_argument("--sigma-px", type=_positive, help="noise of each image coordinate [px]; without: not known")
    parser.add_argument(
        "--sigma-position", type=_not_negative, help="noise of each coordinate [--unit]; 0: exact; without: not known"
    )
    return command.run("make_dataset", lambda: _convert(parser.parse_args(arguments)))


def _convert(options: argparse.Namespace) -> None:
    named = dict(options.cameras)
    if len(named) != len(options.cameras):
        raise DataError("Each camera may be given once.")
    metres, target = _UNITS[options.unit], options.output
    sightings = {name: _READERS[options.format](path) for name, path in named.items()}
    sigma_m = None if options.sigma_position is None else metres * options.sigma_position
    content = dataset_from(sightings, options.image_size, metres, options.sigma_px, sigma_m)
    (problem,) = problems(content)
    try:
        write_whole(target, json.dumps(content, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise DataError(f"{target}: {error.strerror}.", file=str(target)) from error
    spots = ", ".join(
        f"{count} spots of {name}" for name, count in zip(named, problem.detected.sum(axis=1), strict=True)
    )
    unknown = " and ".join(problem.noise_to_estimate)
    print(
        f"{target}: {len(problem.positions)} positions, {spots}" + (f"; {unknown} noise not known" if unknown else "")
    )


def _camera(text: str) -> tuple[str, Path]:
    name, equals, path = text.partition("=")
    if not (name and equals and path):
        raise argparse.ArgumentTypeError(f"'{text}' is not CAMERA=FILE")
    return name, Path(path)


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
