"""Tool that computes a calibration."""

from typing import ClassVar

from im_vss.calibration import Calibration, CalibrationProblem, calibrate
from im_vss.tools.tool import Tool


class ToolCalibrate(Tool):
    """Solves for the cameras; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_calibrate"

    def __call__(self, problem: CalibrationProblem) -> Calibration:
        """The joint estimate of all cameras.

        Raises:
            ImError: The observations do not determine the cameras.
        """
        return calibrate(problem)
