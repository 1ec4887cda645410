"""Camera calibration: pose and imaging of cameras, from a wrist LED moved by the robot.

A library: no ROS, no vision services; of our packages it knows `im_core`, `im_bag` and `im_cell`. The story is told in
:mod:`im_calibration.pipeline`: problem, estimation, judgement; then reporting, and :mod:`im_calibration.design` for
what to measure next; ``commands`` has the programs.

A ceiling camera from simulated spots; the examples of the names below go on with these variables:

    >>> import numpy as np
    >>> from im_calibration import *
    >>> from im_cell.camera_model import CameraModel
    >>> from im_cell.workspace import box_around
    >>> K = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])
    >>> true = CameraModel(640, 480, K, np.zeros(5), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 3.0]))
    >>> places = np.random.default_rng(1).uniform((-0.7, -0.5, 0.6), (0.7, 0.5, 1.6), (40, 3))
    >>> still = np.tile(np.eye(3), (40, 1, 1))
    >>> noise = np.random.default_rng(2).normal(0.0, 0.1, (1, 40, 2))
    >>> spots, of_spots = true.project(places) + noise, np.tile(1e-2 * np.eye(2), (1, 40, 1, 1))
    >>> box = box_around(places)
    >>> problem = CalibrationProblem(("ceiling",), ((640, 480),), places, 1e-8 * still, still, spots, of_spots, box)
    >>> calibration = calibrate(problem)
    >>> calibration.success, f"{calibration.cameras[0].model.position[2]:.1f} m high"
    (True, '3.0 m high')
"""

from im_calibration.design import Candidates, NextPose, load_candidates, next_best_poses
from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.judgement.calibration import Calibration, CameraEstimate, Rejection, Verdict
from im_calibration.pipeline import calibrate
from im_calibration.problem.dataset import dataset_of, dataset_of_views, load_problems
from im_calibration.problem.observations import (
    TARGET_NOISE,
    Observation,
    SeenLength,
    SeenPoints,
    SeenSpot,
    problem_of,
    views_of,
)
from im_calibration.problem.problem import CalibrationProblem, KnownLengths
from im_calibration.problem.target_problem import problem_of_views
from im_calibration.reporting.comparison import SAME, comparison, largest_difference
from im_calibration.reporting.report import answer, report_of
from im_calibration.reporting.results import write_observations, write_results
from im_calibration.selection import calibrate_possible

__all__ = [
    "SAME",
    "TARGET_NOISE",
    "Calibration",
    "CalibrationProblem",
    "CameraEstimate",
    "Candidates",
    "DegenerateDataError",
    "InconsistentDataError",
    "KnownLengths",
    "NextPose",
    "Observation",
    "Rejection",
    "SeenLength",
    "SeenPoints",
    "SeenSpot",
    "Verdict",
    "answer",
    "calibrate",
    "calibrate_possible",
    "comparison",
    "dataset_of",
    "dataset_of_views",
    "largest_difference",
    "load_candidates",
    "load_problems",
    "next_best_poses",
    "problem_of",
    "problem_of_views",
    "report_of",
    "views_of",
    "write_observations",
    "write_results",
]
