"""Vision Module of the computer's time for calibrations."""

from functools import partial
from typing import ClassVar

from im_calibration import Calibration, CalibrationProblem, calibrate_possible
from im_vss.managers.vmm import Lease
from im_vss.modules.module import VisionModule


class VmSolver(VisionModule):
    """Solves for cameras, one calibration at a time: two at once would take as long, and everybody else's time too."""

    name: ClassVar[str] = "vm_solver"
    computes: ClassVar[bool] = True

    def solve(self, lease: Lease, problem: CalibrationProblem) -> Calibration:
        """The joint estimate of the cameras that can be estimated.

        Raises:
            ImError: See :meth:`VisionModule.run`, or the observations determine no camera.
        """
        return self.run(lease, partial(calibrate_possible, problem))
