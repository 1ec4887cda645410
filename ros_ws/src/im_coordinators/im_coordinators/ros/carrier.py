"""Which arm carries the light of a calibration."""

from im_core.ros.dom import DomClient
from im_msgs.msg import CameraNames

CAMERAS = "calibration_cameras"
DEFAULT_GROUP = "left"


async def carrier(dom: DomClient) -> str:
    """Name of the group that carries the light of the calibration under way, of the left arm if there is none."""
    if not await dom.is_valid(CAMERAS):
        return DEFAULT_GROUP
    wanted: CameraNames = await dom.get(CAMERAS, CameraNames)
    return wanted.light.removesuffix("_led")
