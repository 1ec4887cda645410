"""Verdicts: what the data cannot determine, and residuals that the stated noise cannot explain."""

import numpy as np
from numpy.typing import NDArray

from im_vss.calibration.calibration import Calibration, Verdict
from im_vss.calibration.covariance import Covariance
from im_vss.calibration.problem import CalibrationProblem
from im_vss.calibration.unknowns import Layout


def judge(
    calibration: Calibration, problem: CalibrationProblem, layout: Layout, covariance: Covariance
) -> tuple[Verdict, ...]:
    return ()
