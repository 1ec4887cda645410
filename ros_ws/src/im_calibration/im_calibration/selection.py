"""Calibration of the cameras that the observations determine, where they determine some only."""

from dataclasses import replace

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.judgement.calibration import Calibration, Verdict
from im_calibration.judgement.verdicts import MISFIT, UNOBSERVABLE
from im_calibration.pipeline import calibrate
from im_calibration.problem.problem import CalibrationProblem


def calibrate_possible(problem: CalibrationProblem) -> Calibration:
    """Calibrate all cameras together, without those that alone stand in the way of the others.

    A camera with too few spots, or with spots that fit no camera, says little about the others: leave it out, and say
    why in `Calibration.left_out`. Where the others cannot be used either, none is left out.

    Returns:
        The estimate of the remaining cameras; arrays are those of ``problem.of_cameras`` with their names.

    Raises:
        DegenerateDataError: There is no estimate of any camera.
        InconsistentDataError: There is no estimate of any camera.

    >>> calibrate_possible(problem).left_out
    ()
    """
    if problem.placements is not None and problem.placements.held is not None:
        return calibrate(problem)  # the first camera is the world of the others
    try:
        whole = calibrate(problem)
        reasons = _of_single_cameras(whole)
    except (DegenerateDataError, InconsistentDataError) as error:
        name = error.facts.get("camera")
        if name not in problem.camera_names or len(problem.camera_names) == 1:
            raise
        kind = UNOBSERVABLE if isinstance(error, DegenerateDataError) else MISFIT
        reasons = {str(name): Verdict(kind, error.parameters, error.reason, error.advice)}
        try:
            rest = calibrate_possible(_without(problem, reasons))
        except (DegenerateDataError, InconsistentDataError):
            raise error from None  # of the first camera; the others have no better
    else:
        if not 0 < len(reasons) < len(problem.camera_names):
            return whole
        rest = calibrate(_without(problem, reasons))
        if not rest.usable:
            return whole
    return replace(rest, left_out=(*rest.left_out, *reasons.values()))


def _of_single_cameras(calibration: Calibration) -> dict[str, Verdict]:
    """Return the verdicts by camera, if each is about the parameters of one camera; else nothing."""
    verdicts = {}
    for verdict in calibration.verdicts:
        cameras = {parameter.partition(".")[0] for parameter in verdict.parameters}
        if verdict.kind != UNOBSERVABLE or len(cameras) != 1:
            return {}
        verdicts[cameras.pop()] = verdict
    return verdicts if set(verdicts) <= {camera.name for camera in calibration.cameras} else {}


def _without(problem: CalibrationProblem, left_out: dict[str, Verdict]) -> CalibrationProblem:
    return problem.of_cameras(tuple(name for name in problem.camera_names if name not in left_out))
