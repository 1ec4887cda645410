"""What the calibration under way says to the coordinators: data object ``calibration_cameras``."""

from im_coordinators.motion import DEFAULT_GROUP, carrier_of
from im_coordinators.requests import calibration_request
from im_core.ros.dom import DomClient
from im_msgs.msg import CameraNames
from im_pnt.execution.functions import ActionContext

CAMERAS = "calibration_cameras"


async def cameras_of(ctx: ActionContext, dom: DomClient) -> list[str]:
    """Names of the cameras that are to look: those of the request, or of the calibration under way."""
    return calibration_request(ctx.request_arguments).cameras or list((await dom.get(CAMERAS, CameraNames)).cameras)


async def group_of(ctx: ActionContext, dom: DomClient) -> str:
    """Name of the group that is to move: that of the request, or the one with the light; left where there is none."""
    if group := calibration_request(ctx.request_arguments).group:
        return group
    if not await dom.is_valid(CAMERAS):
        return DEFAULT_GROUP
    return carrier_of((await dom.get(CAMERAS, CameraNames)).light)
