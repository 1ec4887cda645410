"""Writes a calibration into a directory: report, summary, plots, and a file for each camera."""

import io
import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from im_calibration.judgement.calibration import Calibration, CameraEstimate
from im_calibration.problem.problem import CalibrationProblem
from im_calibration.reporting.report import report_of
from im_calibration.targets.views import ShownViews
from im_cell.calibration_files import (
    COVARIANCE,
    EXTRINSICS,
    CameraPose,
    Rectified,
    camera_files,
    camera_info_yaml,
    change_camera_files,
    covariance_yaml,
    extrinsics_yaml,
)
from im_cell.calibration_summary import summary
from im_cell.camera_covariance import CameraCovariance
from im_core.errors import DataError
from im_core.files import FileError, make_folder, write_whole
from im_core.text.jsontext import load_json

OBSERVATIONS = "observations.json"
"""Name of the file of observations in a folder of results."""


def write_results(
    directory: Path | str,
    calibration: Calibration,
    problem: CalibrationProblem,
    poses: Mapping[str, CameraPose] | None = None,
    rectified: Mapping[str, Rectified] | None = None,
    covariance: CameraCovariance | None = None,
    shown: ShownViews | None = None,
) -> tuple[Path, ...]:
    """Write ``report.json``, ``summary.txt``, plots, ``<camera>.yaml`` (`camera_info_manager`) and the poses.

    Each file appears whole or not at all. Camera files, poses and how well they are known, see
    :mod:`im_cell.calibration_files`, are written for cameras that can be used only; those that a former calibration
    left in the directory are taken away. For the observations see :func:`write_observations`.

    Args:
        directory: Where; made if missing.
        calibration: The result.
        problem: What it was made from.
        poses: Poses of the cameras relative to what they are fixed to; None: all are fixed to the world.
        rectified: R and P of the cameras; None: all are single cameras.
        covariance: Of the cameras with these poses; None: all are fixed to the world.
        shown: A view of the target by each camera, its name and the image, for ``overlay.png``; None: there is none.

    Returns:
        The files.

    Raises:
        DataError: The directory cannot be written.
    """
    report = report_of(calibration, problem)
    contents = {
        "report.json": (json.dumps(report, indent=2, allow_nan=False) + "\n").encode(),
        "summary.txt": summary(report).encode(),
    }
    cameras: dict[str, str] = {}
    if calibration.usable:
        for camera, image in zip(calibration.cameras, calibration.images, strict=True):
            comment = f"---\n# {image.told}\n" if image.told else "---\n"  # before the header OpenCV reads no file
            cameras[f"{camera.name}.yaml"] = _camera_file(camera, rectified).replace("---\n", comment, 1)
        in_world = {camera.name: CameraPose.of("world", camera.model) for camera in calibration.cameras}
        cameras[EXTRINSICS] = extrinsics_yaml(poses or in_world)
        cameras[COVARIANCE] = covariance_yaml(covariance or calibration.camera_covariance)
    contents |= _pictures(calibration, problem.of_cameras([camera.name for camera in calibration.cameras]), shown or {})
    target = Path(directory)
    try:
        make_folder(target)
        change_camera_files(target, {**dict.fromkeys(_former(target)), **cameras})
        written = [write_whole(target / name, content) for name, content in contents.items()]
        return (*written, *(target / name for name in cameras))
    except OSError as error:
        raise _unwritten(target, error) from error


def write_observations(directory: Path | str, content: Mapping[str, Any]) -> Path:
    """Write ``observations.json``, the data set for ``calibrate_dataset`` and ``next_best_pose``.

    Args:
        directory: Where; made if missing.
        content: The data set.

    Raises:
        DataError: The directory cannot be written.
    """
    target = Path(directory)
    try:
        make_folder(target)
        return write_whole(target / OBSERVATIONS, json.dumps(content, allow_nan=False) + "\n")
    except OSError as error:
        raise _unwritten(target, error) from error


def _unwritten(target: Path, error: OSError) -> DataError:
    return DataError(f"The results cannot be written to {target}: {error.strerror}.", file=str(target))


def _camera_file(camera: CameraEstimate, rectified: Mapping[str, Rectified] | None) -> str:
    return camera_info_yaml(camera.name, camera.model, rectified[camera.name] if rectified else None)


def _former(directory: Path) -> set[str]:
    """Return the camera files left by a former calibration, according to the report; other files are not included."""
    try:
        report = load_json(directory / "report.json")
    except FileError:
        return set()
    names = []
    match report:
        case {"cameras": [*cameras]}:
            names = [camera["name"] for camera in cameras if isinstance(camera, dict) and "name" in camera]
    written = {EXTRINSICS, COVARIANCE, *(f"{name}.yaml" for name in names)}
    return written & {path.name for path in camera_files(directory)}


def _pictures(calibration: Calibration, problem: CalibrationProblem, shown: ShownViews) -> dict[str, bytes]:
    """Return the plots by file name; matplotlib is loaded with the first plot, not at the start of a node."""
    from im_calibration.reporting.plots import plot_coverage, plot_geometry, plot_overlay, plot_residuals

    plots: dict[str, Callable[..., None]] = {
        "residuals": plot_residuals,
        "coverage": plot_coverage,
        "geometry": plot_geometry,
    }
    if shown:
        plots["overlay"] = partial(plot_overlay, shown=shown)
    pictures = {}
    for name, plot in plots.items():
        buffer = io.BytesIO()
        plot(calibration, problem, target=buffer)
        pictures[f"{name}.png"] = buffer.getvalue()
    return pictures
