"""Calibration data sets in files: the format ``vislab-calib-1``, and what the solver answers to one."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, ImError
from im_core.workspace import Workspace
from im_vss.calibration.errors import DegenerateDataError, InconsistentDataError
from im_vss.calibration.pipeline import calibrate
from im_vss.calibration.problem import CalibrationProblem
from im_vss.calibration.report import number, numbers

SCHEMA = "vislab-calib-1"


def problem_of_trial(dataset: dict[str, Any], trial: dict[str, Any]) -> CalibrationProblem:
    """The problem of one trial; nothing of the truth in the file is looked at.

    Args:
        dataset: Contents of the file.
        trial: One entry of its ``trials``.

    Raises:
        DataError: A field is missing or has the wrong shape.
    """
    try:
        spots = np.array([[uv or (np.nan, np.nan) for uv in camera] for camera in trial["u_px"]], dtype=float)
        sigma = np.array(dataset["sigma_u_px"], dtype=float)
        positions = np.array(trial["x_base_m"], dtype=float)
        width, height = (int(side) for side in dataset["image_size"])
        known = bool(dataset.get("led_offset_nominal_known", True))
        led_prior = 0.0 if known else float(dataset["led_offset_prior_sd_m"])
        joint_prior = float(dataset.get("joint_offset_prior_sd_rad") or 0.0)
        jacobians = dataset.get("J_joint") if joint_prior > 0.0 else None
        covariances = np.array(dataset["cov_x_m2"], dtype=float)
        wrists = dataset.get("wrist_R_base")
        rotations = np.broadcast_to(np.eye(3), covariances.shape) if wrists is None else np.array(wrists, dtype=float)
    except KeyError as error:
        raise DataError(f"The data set has no field {error}.", field=str(error)) from error
    except (TypeError, ValueError) as error:
        raise DataError(f"The data set has a field of the wrong kind: {error}.") from error
    if sigma.shape != spots.shape[:2]:
        raise DataError(f"sigma_u_px has shape {sigma.shape}, the spots have {spots.shape[:2]}.", field="sigma_u_px")
    return CalibrationProblem(
        camera_names=tuple(f"camera_{c}" for c in range(len(spots))),
        image_sizes=((width, height),) * len(spots),
        positions=positions,
        position_covariances=covariances,
        wrist_rotations=rotations,
        spots=spots,
        spot_covariances=sigma[..., None, None] ** 2 * np.eye(2),
        led_offset_prior_sd=led_prior,
        joint_offset_prior_sd=joint_prior,
        joint_jacobians=None if jacobians is None else np.array(jacobians, dtype=float),
        workspace=_box_around(positions),
    )


def answer_to_trial(dataset: dict[str, Any], trial: dict[str, Any]) -> dict[str, Any]:
    """What the calibrator writes for one trial; where no estimate is possible, no cameras, and the flag says why."""
    problem = problem_of_trial(dataset, trial)
    try:
        result = calibrate(problem)
    except (DegenerateDataError, InconsistentDataError) as error:
        flag = "UNOBSERVABLE" if isinstance(error, DegenerateDataError) else "MISFIT"
        return {"cameras": [], "chi2_per_dof": None, "flags": [flag], "message": error.message}
    answer: dict[str, Any] = {
        "cameras": [
            {
                "K": camera.model.K.tolist(),
                "D": camera.model.D.tolist(),
                "R_cam_base": camera.model.R_cam_base.tolist(),
                "t_cam_base_m": camera.model.t_cam_base.tolist(),
            }
            for camera in result.cameras
        ],
        "chi2_per_dof": number(result.chi2_per_dof),
        "p_value": number(result.p_value),
        "flags": sorted({verdict.kind for verdict in result.verdicts}, reverse=True),
        "message": result.message,
        "outlier": (problem.detected & ~result.used).astype(int).tolist(),
        "parameters": list(result.parameter_names),
        "standard_deviations": numbers(result.standard_deviations),
        "expected_error": {
            "triangulation_mm": number(result.expected.triangulation_rms_mm),
            "reprojection_px": number(result.expected.reprojection_rms_px),
        },
    }
    if problem.led_offset_prior_sd > 0.0:
        answer["led_offset_error_m"] = numbers(result.led_offset_error)
    if len(result.joint_offsets):
        answer["joint_offsets_rad"] = numbers(result.joint_offsets)
    return answer


def answer(dataset: dict[str, Any]) -> dict[str, Any]:
    """Calibrate every trial of a data set.

    Args:
        dataset: Contents of the file.

    Raises:
        DataError: It is not of this format.
    """
    if not isinstance(dataset, dict) or dataset.get("schema") != SCHEMA:
        found = dataset.get("schema") if isinstance(dataset, dict) else type(dataset).__name__
        raise DataError(f"The data set has the schema {found!r}, {SCHEMA!r} is needed.")
    trials = dataset.get("trials")
    if not isinstance(trials, list) or not trials:
        raise DataError("The data set has no trials.")
    return {"trials": [answer_to_trial(dataset, trial) for trial in trials]}


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``calibrate_dataset IN.json OUT.json``."""
    parser = argparse.ArgumentParser(prog="calibrate_dataset", description="Calibrate every trial of a data set.")
    parser.add_argument("input", type=Path, metavar="IN.json", help=f"data set in the format {SCHEMA}")
    parser.add_argument("output", type=Path, metavar="OUT.json", help="where the estimates go")
    options = parser.parse_args(arguments)
    try:
        dataset = json.loads(options.input.read_text(encoding="utf-8"))
        result = answer(dataset)
        options.output.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        print(f"{error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    except json.JSONDecodeError as error:
        print(f"{options.input}:{error.lineno}: not JSON: {error.msg}", file=sys.stderr)
        return 1
    except ImError as error:
        print(f"{options.input}: {error.message}", file=sys.stderr)
        return 1
    for i, trial in enumerate(result["trials"]):
        print(f"trial {i}: {trial['message']}")
    return 0


def _box_around(positions: NDArray[np.float64]) -> Workspace:
    """Box of most positions: errors are predicted where data are, which a file says nothing else about."""
    low, high = np.quantile(positions, 0.03, axis=0), np.quantile(positions, 0.97, axis=0)
    high = np.maximum(high, low + 1e-3)
    return Workspace((low[0], low[1], low[2]), (high[0], high[1], high[2]))


if __name__ == "__main__":
    sys.exit(main())
