"""Solve the calibration of cameras."""

from typing import ClassVar

from im_calibration import Calibration, CalibrationProblem
from im_vss.managers import VisionClient
from im_vss.tools.tool import Tool


class ToolCalibrate(Tool):
    """Tool for the solver of cameras, one calibration after the other."""

    name: ClassVar[str] = "tool_calibrate"

    def __call__(self, client: VisionClient, problem: CalibrationProblem) -> Calibration:
        """The joint estimate of the cameras that can be estimated.

        Raises:
            ImError: The observations determine no camera, or the solver did not become free in time.
        """
        with self.modules.use("vm_solver", client) as (vm_solver, lease):
            calibration: Calibration = vm_solver.solve(lease, problem)
        return calibration
