"""Calibration data sets in the format ``vislab-calib-1``, one problem a trial; the truth in them is not looked at."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_core.workspace import Workspace
from im_vss.calibration.fields import ANY, array, field, scalar
from im_vss.calibration.lengths import KnownLengths
from im_vss.calibration.problem import CalibrationProblem

Array = NDArray[np.float64]

SCHEMA = "vislab-calib-1"

_LARGEST_IMAGE = 100_000


def load_problems(path: Path) -> tuple[CalibrationProblem, ...]:
    """The problems of a file.

    Args:
        path: The file.

    Raises:
        DataError: It cannot be read, is no JSON, or not of this format; file, line or field are named.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}.", file=str(path)) from error
    except json.JSONDecodeError as error:
        raise DataError(f"{path}:{error.lineno}: not JSON: {error.msg}.", file=str(path), line=error.lineno) from error
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise DataError(f"{path}: not JSON: {reason}.", file=str(path)) from error
    try:
        return problems(content)
    except DataError as error:
        raise _placed(str(path), error) from error


def problems(content: Any) -> tuple[CalibrationProblem, ...]:
    """The problem of each trial of a data set.

    Args:
        content: Contents of the file.

    Raises:
        DataError: A field is missing, or has the wrong shape or an impossible value; field, trial and pose are named.
    """
    schema = field(content, "schema")
    if schema != SCHEMA:
        raise DataError(f"schema is {schema!r}, {SCHEMA!r} is needed.", field="schema")
    trials = field(content, "trials")
    if not isinstance(trials, list) or not trials:
        raise DataError("trials must be a list of at least one trial.", field="trials")
    covariances = array(field(content, "cov_x_m2"), (ANY, 3, 3), "cov_x_m2")
    n = len(covariances)
    sigma = array(field(content, "sigma_u_px"), (ANY, n), "sigma_u_px")
    c = len(sigma)
    for camera, pose in np.argwhere(sigma <= 0.0):
        value = sigma[camera, pose]
        raise DataError(f"sigma_u_px[{camera}][{pose}] is {value:g}, it must be > 0 [px].", field="sigma_u_px")
    led_prior = _led_prior(content)
    joint_prior = scalar(content.get("joint_offset_prior_sd_rad") or 0.0, "joint_offset_prior_sd_rad")
    jacobians = array(field(content, "J_joint"), (n, 3, ANY), "J_joint") if joint_prior != 0.0 else None
    if content.get("wrist_R_base") is not None or led_prior > 0.0:
        wrists = array(field(content, "wrist_R_base"), (n, 3, 3), "wrist_R_base")
    else:
        wrists = np.tile(np.eye(3), (n, 1, 1))
    camera_names = _names(content, "camera_names", tuple(f"camera_{j}" for j in range(c)))
    pose_names = _names(content, "pose_names", tuple(str(i) for i in range(n)))
    found = []
    for i, trial in enumerate(trials):
        place = f"trials[{i}]"
        positions = array(field(trial, "x_base_m", place), (n, 3), f"{place}.x_base_m")
        spots = array(field(trial, "u_px", place), (c, n, 2), f"{place}.u_px", holes=True)
        try:
            problem = CalibrationProblem(
                camera_names=camera_names,
                image_sizes=(_image_size(content),) * c,
                positions=positions,
                position_covariances=covariances,
                wrist_rotations=wrists,
                spots=spots,
                spot_covariances=sigma[..., None, None] ** 2 * np.eye(2),
                led_offset_prior_sd=led_prior,
                joint_offset_prior_sd=joint_prior,
                joint_jacobians=jacobians,
                workspace=_box_around(positions),
                pose_names=pose_names,
                lengths=_lengths(content, trial, c, place),
            )
        except DataError as error:
            raise _placed(place, error) from error
        found.append(problem)
    return tuple(found)


def _placed(place: str, error: DataError) -> DataError:
    """The same error, its message led by where it is."""
    placed = DataError(f"{place}: {error.message}", code=error.code)
    placed.facts.update({"place": place, **error.facts})
    return placed


def _names(content: Any, key: str, default: tuple[str, ...]) -> tuple[str, ...]:
    """Optional names, as many as there are by default."""
    names = content.get(key)
    if names is None:
        return default
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        raise DataError(f"{key} must be a list of names.", field=key)
    if len(names) != len(default) or len(set(names)) != len(names):
        raise DataError(f"{key} must be {len(default)} different names, got {', '.join(names)}.", field=key)
    return tuple(names)


def _led_prior(content: Any) -> float:
    known = content.get("led_offset_nominal_known", True)
    if not isinstance(known, bool):
        raise DataError(f"led_offset_nominal_known is {known!r}, true or false is needed.")
    if known:
        return 0.0
    prior = scalar(field(content, "led_offset_prior_sd_m"), "led_offset_prior_sd_m")
    if prior <= 0.0:
        raise DataError(f"led_offset_prior_sd_m is {prior:g}, it must be > 0 [m] where the LED offset is not known.")
    return prior


def _lengths(content: Any, trial: Any, c: int, place: str) -> KnownLengths | None:
    """The optional ``known_lengths`` of a data set with a trial's spots of them."""
    known = content.get("known_lengths")
    if known is None:
        return None
    true = array(field(known, "length_m", "known_lengths"), (ANY,), "known_lengths.length_m")
    k = len(true)
    deviations = array(field(known, "sd_m", "known_lengths"), (k,), "known_lengths.sd_m")
    sigma = array(field(known, "sigma_u_px", "known_lengths"), (c, k), "known_lengths.sigma_u_px")
    spots = array(field(trial, "length_u_px", place), (c, k, 2, 2), f"{place}.length_u_px", holes=True)
    return KnownLengths(true, deviations, spots, sigma[..., None, None, None] ** 2 * np.tile(np.eye(2), (2, 1, 1)))


def _image_size(content: Any) -> tuple[int, int]:
    width, height = array(field(content, "image_size"), (2,), "image_size")
    if not all(side == int(side) and 1 <= side <= _LARGEST_IMAGE for side in (width, height)):
        raise DataError(f"image_size is {width:g} x {height:g}, whole numbers of pixels from 1 are needed.")
    return int(width), int(height)


def _box_around(positions: Array) -> Workspace:
    """Box of most positions: errors are predicted where data are, which a file says nothing else about."""
    if not len(positions):
        return Workspace()
    low, high = np.quantile(positions, 0.03, axis=0), np.quantile(positions, 0.97, axis=0)
    high = np.maximum(high, low + np.maximum(1e-3, 1e-6 * np.abs(low)))
    return Workspace((low[0], low[1], low[2]), (high[0], high[1], high[2]))


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")
