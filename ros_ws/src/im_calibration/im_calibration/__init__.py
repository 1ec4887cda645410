"""Camera calibration: pose and imaging of cameras, from a wrist LED moved by the robot.

A library: no ROS, no vision services; of our packages it knows `im_core`, `im_bag` and `im_cell`. The story is told in
:mod:`im_calibration.pipeline`: problem, estimation, judgement; then reporting, and :mod:`im_calibration.design` for
what to measure next.
"""

from im_calibration.design import Candidates, NextPose, load_candidates, next_best_poses
from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.judgement.calibration import Calibration, CameraEstimate, Rejection, Verdict
from im_calibration.pipeline import calibrate
from im_calibration.problem.dataset import dataset_of, load_problems
from im_calibration.problem.problem import CalibrationProblem, KnownLengths
from im_calibration.reporting.comparison import SAME, comparison, largest_difference
from im_calibration.reporting.report import answer, report_of, summary
from im_calibration.reporting.results import write_results

__all__ = [
    "SAME",
    "Calibration",
    "CalibrationProblem",
    "CameraEstimate",
    "Candidates",
    "DegenerateDataError",
    "InconsistentDataError",
    "KnownLengths",
    "NextPose",
    "Rejection",
    "Verdict",
    "answer",
    "calibrate",
    "comparison",
    "dataset_of",
    "largest_difference",
    "load_candidates",
    "load_problems",
    "next_best_poses",
    "report_of",
    "summary",
    "write_results",
]
