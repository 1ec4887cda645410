"""Camera calibration: where cameras are and how they image, from a wrist LED moved by the robot. No ROS in here."""

from im_vss.calibration.calibration import Calibration, CameraEstimate, Rejection, Verdict
from im_vss.calibration.errors import DegenerateDataError, InconsistentDataError
from im_vss.calibration.pipeline import calibrate
from im_vss.calibration.problem import CalibrationProblem
from im_vss.calibration.report import report_of, summary
from im_vss.calibration.results import write_results

__all__ = [
    "Calibration",
    "CalibrationProblem",
    "CameraEstimate",
    "DegenerateDataError",
    "InconsistentDataError",
    "Rejection",
    "Verdict",
    "calibrate",
    "report_of",
    "summary",
    "write_results",
]
