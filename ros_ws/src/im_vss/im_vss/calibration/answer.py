"""What a calibrator answers to a trial of a data set: plain values that JSON can hold."""

from typing import Any

import numpy as np

from im_vss.calibration.errors import DegenerateDataError, InconsistentDataError
from im_vss.calibration.pipeline import calibrate
from im_vss.calibration.problem import CalibrationProblem
from im_vss.calibration.report import number, numbers, report_of


def answer(problem: CalibrationProblem) -> dict[str, Any]:
    """Calibrate; where no estimate is possible there are no cameras, and the flag says why.

    Args:
        problem: The trial.

    Returns:
        Cameras, offsets and flags of the format, and what is known about them: message, verdicts with advice,
        outliers, covariance of all parameters, checks, and the errors to expect.
    """
    try:
        result = calibrate(problem)
    except (DegenerateDataError, InconsistentDataError) as error:
        flag = "UNOBSERVABLE" if isinstance(error, DegenerateDataError) else "MISFIT"
        parameters = list(error.parameters)
        verdict = {"kind": flag, "parameters": parameters, "reason": error.reason, "advice": error.advice}
        message = f"{flag}: {error.message}"
        return {"cameras": [], "chi2_per_dof": None, "flags": [flag], "message": message, "verdicts": [verdict]}
    report = report_of(result, problem)
    cameras = [
        {
            "K": camera.model.K.tolist(),
            "D": camera.model.D.tolist(),
            "R_cam_base": camera.model.R_cam_base.tolist(),
            "t_cam_base_m": camera.model.t_cam_base.tolist(),
        }
        for camera in result.cameras
    ]
    told: dict[str, Any] = {
        "cameras": cameras,
        "chi2_per_dof": number(result.chi2_per_dof),
        "p_value": number(result.p_value),
        "flags": sorted({verdict.kind for verdict in result.verdicts}, reverse=True),
        "message": result.message,
        "verdicts": report["verdicts"],
        "outlier": (problem.detected & ~result.used).astype(int).tolist(),
        "rejections": report["points_rejected"],
        "parameters": list(result.parameter_names),
        "standard_deviations": numbers(result.standard_deviations),
        "covariance": [numbers(row) for row in np.asarray(result.covariance)],
        "scale": report["scale"],
        "checks": report["checks"],
        "expected_error": report["expected_error"],
    }
    if problem.led_offset_prior_sd > 0.0:
        told["led_offset_error_m"] = numbers(result.led_offset_error)
    if len(result.joint_offsets):
        told["joint_offsets_rad"] = numbers(result.joint_offsets)
    return told
