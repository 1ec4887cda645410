"""Tool for the points of a calibration target in an image."""

from typing import ClassVar

from im_calibration.targets.detection import Detection, detect
from im_calibration.targets.target import CalibrationTarget
from im_cell.frames import Frame
from im_vss.tools.tool import Tool


class ToolTargetFind(Tool):
    """Tool for the points of a target; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_target_find"

    def __call__(self, frame: Frame, target: CalibrationTarget) -> Detection | None:
        """Return the points of a target in an image; None: it is not seen whole."""
        return detect(frame.image, target)
