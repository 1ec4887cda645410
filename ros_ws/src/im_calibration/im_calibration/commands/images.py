"""Calibration from images of a target: ``im calibrate --images CAMERA=FOLDER ... --target TARGET --results FOLDER``.

Or of a bag: ``im calibrate --bag BAG --camera NAME:=TOPIC ... --target TARGET --results FOLDER``.
"""

import argparse
import math
import re
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, RootModel, ValidationError

from im_calibration.problem.dataset import dataset_of_views, problems
from im_calibration.problem.problem import CalibrationProblem
from im_calibration.reporting.results import write_observations
from im_cell.calibration_files.intrinsics import read_intrinsics
from im_cell.camera_model import CameraModel
from im_cell.lens import PLUMB_BOB, RATIONAL_POLYNOMIAL, lens_of
from im_core.config import Model, faults, field_name, parse_model
from im_core.errors import DataError
from im_core.files import make_folder, read_text
from im_core.processes.process import ChildProcess
from im_core.text.jsontext import load_json

if TYPE_CHECKING:
    from im_calibration.targets.images import SeenTarget
    from im_calibration.targets.recorded_views import Motion

Array = NDArray[np.float64]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Units of length [m]."""
_END_OF_RECORDING_S = 30.0


def add_images(parser: argparse.ArgumentParser) -> None:
    """Add the options of a calibration from images."""
    images = parser.add_argument_group("from images of a target, instead of IN.json OUT.json")
    images.add_argument(
        "--images", nargs="+", type=named, metavar="CAMERA=FOLDER", help="folder of images of each camera, or its video"
    )
    images.add_argument("--bag", type=Path, metavar="BAG", help="instead: a bag with images, see --camera")
    images.add_argument(
        "--camera", nargs="+", type=_remapped, metavar="NAME:=TOPIC", help="cameras, and topics of their images in BAG"
    )
    images.add_argument(
        "--seconds", type=float, metavar="S", help="instead of BAG: record one for so long, or until Ctrl-C, and use it"
    )
    images.add_argument("--target", metavar="TARGET", help="such as chessboard:9x6:25mm, or a file of Kalibr")
    images.add_argument("--results", type=Path, metavar="FOLDER", help="where the results go")
    images.add_argument(
        "--intrinsics", nargs="+", type=named, default=[], metavar="CAMERA=FILE",
        help="known intrinsics: a camera's YAML or Kalibr's camera chain, which are held, or a report.json",
    )  # fmt: skip
    images.add_argument(
        "--robot", type=Path, metavar="POSES",
        help="poses of the robot's link in its base; with BAG: lines of stamp, place and quaternion x, y, z, w",
    )  # fmt: skip
    images.add_argument("--base", metavar="FRAME", help="with BAG: the robot's base in its transforms")
    images.add_argument("--tool", metavar="FRAME", help="with BAG: the robot's link in its transforms")
    images.add_argument("--urdf", type=Path, metavar="FILE", help="description of the robot: BAG has its joint states")
    images.add_argument("--order", choices=("xyzw", "wxyz"), help="order of quaternions in lines of POSES")
    images.add_argument("--unit", choices=sorted(UNITS), default="m", help="unit of places in POSES (%(default)s)")
    eye = images.add_mutually_exclusive_group()
    eye.add_argument("--eye-in-hand", action="store_true", help="the cameras are on the link, the target is at rest")
    eye.add_argument("--eye-to-hand", action="store_true", help="the target is on the link, the cameras are at rest")
    images.add_argument(
        "--sd-robot", nargs=2, type=float, metavar=("MM", "MRAD"), help="noise of POSES (default: unknown)"
    )


def check_images(options: argparse.Namespace) -> str:
    """Return the fault in the options of a calibration from images; empty if there is none."""
    if (options.bag is not None) + (options.seconds is not None) + bool(options.images) != 1:
        return "--images are needed, or --camera with --bag or --seconds"
    if bool(options.images) == bool(options.camera):
        return "--camera names topics of a bag"
    if options.seconds is not None and not 0.0 < options.seconds < math.inf:
        return "--seconds needs a number > 0"
    if not (options.target and options.results):
        return "images need --target and --results"
    if bool(options.base) != bool(options.tool) or (options.base and not options.camera):
        return "--base and --tool go together, with --camera"
    if options.urdf and (options.robot or not options.base):
        return "--urdf needs --base and --tool, and no --robot"
    if options.robot and options.base:
        return "the robot's poses are in --robot, or between --base and --tool"
    robot = bool(options.robot or options.base)
    if robot != (options.eye_in_hand or options.eye_to_hand):
        return "poses of a robot need --eye-in-hand or --eye-to-hand, and they need --robot, or --base and --tool"
    if options.sd_robot and not (robot and all(0.0 < value < 1e3 for value in options.sd_robot)):
        return "--sd-robot needs poses of a robot, and two numbers > 0"
    cameras = options.images or options.camera
    if len(dict(cameras)) < len(cameras):
        return "each camera may be given once"
    return ""


def problem_of_images(options: argparse.Namespace) -> tuple[CalibrationProblem, "SeenTarget"]:
    """Find the target in the images, and write the observations.

    Returns:
        The problem, and the target in the images.

    Raises:
        DataError: A file cannot be used, the target is in too few images, or the views do not belong together.
    """
    from im_calibration.recorded.recordings import VIDEOS, BagImages, ImageRecording, VideoFile
    from im_calibration.targets.images import find_target
    from im_calibration.targets.robot_file import read_poses
    from im_calibration.targets.target import target_of
    from im_calibration.targets.views import RobotPoses, TargetViews

    target = target_of(options.target)
    if options.seconds is not None:
        options.bag = _recorded(options)
    sources: dict[str, Path | ImageRecording] = {name: BagImages(options.bag, at) for name, at in options.camera or ()}
    for name, path in options.images or ():
        sources[name] = VideoFile(Path(path)) if Path(path).suffix.lower() in VIDEOS else Path(path)
        if options.robot and isinstance(sources[name], VideoFile):
            raise DataError(f"{path}: images of a video have no stamps of the robot; record both in a bag.")
    given = {name: _given(name, Path(path), options.lens_model) for name, path in options.intrinsics}
    if foreign := given.keys() - sources.keys():
        raise DataError(f"--intrinsics names {', '.join(sorted(foreign))}, --images {', '.join(sources)}.")
    motion = _motion(options) if options.camera and (options.base or options.robot) else None
    seen = find_target(sources, target, motion)
    sizes = dict(zip(sources, seen.image_sizes, strict=True))
    for name, path in options.intrinsics:
        if given[name].size != sizes[name]:
            told = "{} x {} px, the images have {} x {} px".format(*given[name].size, *sizes[name])
            raise DataError(f"{path}: is of images of {told}.", camera=name)
    lenses = tuple(given[name].lens if name in given else options.lens_model or PLUMB_BOB.name for name in sources)
    robot = None
    if options.robot or motion:
        if motion is not None and seen.stamps is not None:
            poses = motion(seen.stamps)
        else:
            by_name = read_poses(options.robot, seen.names, options.order, UNITS[options.unit])
            seen = seen.with_poses(by_name, options.robot)
            poses = np.array([by_name[name] for name in seen.names])
        mm, mrad = options.sd_robot or (1.0, 2.0)
        robot = RobotPoses(poses, options.eye_in_hand, 1e-3 * mm, 1e-3 * mrad)
    known = {name: (each.values, each.covariance) for name, each in given.items()}
    views = TargetViews(
        str(target), target.points, tuple(sources), seen.image_sizes, lenses, seen.names, seen.spots, seen.deviations,
        robot, known,
    )  # fmt: skip
    unknown = ["image"] + ["robot"] * bool(robot and not options.sd_robot)
    content = dataset_of_views(views, unknown)
    write_observations(options.results, content)
    return problems(content)[0], seen


def _recorded(options: argparse.Namespace) -> Path:
    """Record the topics of the cameras and of the robot, and return the bag.

    Raises:
        DataError: The recorder fails; it says why.
    """
    from im_calibration.recorded.transforms import JOINT_STATES, TF, TF_STATIC

    bag: Path = options.results / "bag"
    robot = [JOINT_STATES] if options.urdf else [TF, TF_STATIC] if options.base else []
    topics = [*(topic for _, topic in options.camera), *robot]
    make_folder(options.results)
    recorder = ChildProcess.of_module("im_bag.ros.recorder", ["-o", str(bag), "--topics", *topics])
    with suppress(KeyboardInterrupt):
        recorder.await_end(options.seconds)
    recorder.stop(_END_OF_RECORDING_S)
    if recorder.poll() != 0:
        raise DataError(f"{bag}: was not recorded: {recorder.obituary()}.")
    return bag


def _motion(options: argparse.Namespace) -> "Motion":
    """Return the poses of the robot's link over time, by transforms, joint states or a file."""
    from im_calibration.recorded.transforms import tree_of_bag, tree_of_file, tree_of_joints

    if options.robot:
        return partial(tree_of_file(options.robot, "base", "link").poses, "base", "link")
    tree = tree_of_joints(options.bag, options.urdf) if options.urdf else tree_of_bag(options.bag)
    return partial(tree.poses, options.base, options.tool)


def _remapped(text: str) -> tuple[str, str]:
    """Return name and topic of ``NAME:=TOPIC``."""
    name, remapped, topic = text.partition(":=")
    if not (remapped and topic):
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form NAME:=TOPIC")
    return named(f"{name}={topic}")


def named(text: str) -> tuple[str, str]:
    """Return name and value of ``NAME=VALUE``."""
    name, equals, path = text.partition("=")
    if not (name and equals and path):
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form CAMERA=...")
    if Path(name).name != name:
        raise argparse.ArgumentTypeError(f"'{name}' is no name of a camera, it becomes that of a file")
    return name, path


@dataclass(frozen=True)
class _KnownIntrinsics:
    """Intrinsics of a camera from elsewhere: lens model, fx, fy, cx, cy with coefficients, covariance, image size."""

    lens: str
    values: Array
    covariance: Array
    size: tuple[int, int]


def _given(name: str, path: Path, lens_model: str | None) -> _KnownIntrinsics:
    """Return known intrinsics of a file; without a covariance, hold the values."""
    found = _from_report(name, path) if path.suffix == ".json" else _held(_model(name, path))
    if lens_model not in (None, found.lens):
        raise DataError(f"{path}: the lens model is {found.lens}, --lens-model says {lens_model}.", file=str(path))
    return found


def _held(model: CameraModel) -> _KnownIntrinsics:
    """Hold the intrinsics of a camera, a `plumb_bob` lens with a k3 by the model with more terms."""
    lens = model.lens if not np.any(model.D[model.lens.estimated :]) else RATIONAL_POLYNOMIAL
    D = np.pad(model.D, (0, max(0, lens.estimated - len(model.D))))[: lens.estimated]
    values = np.concatenate((model.K[[0, 1, 0, 1], [0, 1, 2, 2]], D))
    covariance = np.diag(1e-7 * np.maximum(np.abs(values), 1e-3)) ** 2
    return _KnownIntrinsics(lens.name, values, covariance, (model.width, model.height))


class _KalibrCamera(Model):
    """A camera of Kalibr's camera chain; other fields of the file are not read."""

    model_config = ConfigDict(extra="ignore")

    camera_model: Literal["pinhole"]
    intrinsics: Annotated[list[float], Field(min_length=4, max_length=4)]
    distortion_model: Literal["radtan", "equidistant"]
    distortion_coeffs: Annotated[list[float], Field(min_length=4, max_length=4)]
    resolution: Annotated[list[int], Field(min_length=2, max_length=2)]


class _KalibrCameras(RootModel[dict[str, dict[str, Any]]]):
    """Kalibr's camera chain, by name of the camera."""


def _model(name: str, path: Path) -> CameraModel:
    """Return a camera of a file of `camera_info_manager`, or a named one of Kalibr's camera chain."""
    text = read_text(path)
    if not re.search(r"^cam\d+:", text, re.MULTILINE):
        return read_intrinsics(path).model
    chain = parse_model(text, _KalibrCameras, str(path)).root
    if name not in chain:
        raise DataError(f"{path}: has no camera {name}, there are {', '.join(chain)}.", file=str(path))
    try:
        camera = _KalibrCamera.model_validate(chain[name])
    except ValidationError as error:
        fault = faults(error, _KalibrCamera)[0]
        raise DataError(f"{path}: {name}.{field_name(fault.location)} {fault.words}.", file=str(path)) from error
    fx, fy, cx, cy = camera.intrinsics
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    lens = lens_of({"radtan": PLUMB_BOB.name}.get(camera.distortion_model, camera.distortion_model))
    width, height = camera.resolution
    return CameraModel(width, height, K, lens.all_of(camera.distortion_coeffs), distortion_model=lens.name)


def _from_report(name: str, path: Path) -> _KnownIntrinsics:
    report = load_json(path)
    match report:
        case {"cameras": [*cameras]}:
            for camera in cameras:
                match camera:
                    case {
                        "name": str() as own,
                        "width": int() as width,
                        "height": int() as height,
                        "K": K,
                        "D": D,
                        "covariance": rows,
                        "distortion_model": str() as model,
                    } if own == name:
                        size = 4 + lens_of(model).estimated
                        try:
                            values = np.concatenate((np.array(K, dtype=float)[[0, 1, 0, 1], [0, 1, 2, 2]], D))[:size]
                            covariance = np.array(rows, dtype=float)[:size, :size]
                            np.linalg.cholesky(covariance)
                        except (ValueError, TypeError, IndexError, np.linalg.LinAlgError) as error:
                            raise DataError(f"{path}: K, D or covariance of {name} are not whole.") from error
                        return _KnownIntrinsics(model, values, covariance, (width, height))
    raise DataError(f"{path}: has no camera {name} with width, height, K, D and covariance.", file=str(path))
