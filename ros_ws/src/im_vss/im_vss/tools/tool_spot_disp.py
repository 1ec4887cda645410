"""Tool that marks the spot on the monitor."""

from collections.abc import Mapping
from typing import ClassVar

from im_vss.managers import VisionClient
from im_vss.monitor import Marker
from im_vss.spot import Finding
from im_vss.tools.tool import Tool


class ToolSpotDisp(Tool):
    """Draws a marker on top of the image on each camera's monitor (paper: toolSpotDisp)."""

    name: ClassVar[str] = "tool_spot_disp"

    def __call__(self, client: VisionClient, findings: Mapping[str, Finding]) -> None:
        """Mark the spot of each camera, or write why there is none.

        Raises:
            ImError: The display is not to be had.
        """
        markers = tuple(_marker(camera, finding) for camera, finding in findings.items())
        with self.modules.use("vm_spot_disp", client) as (vm_spot_disp, lease):
            vm_spot_disp.mark(lease, markers)


def _marker(camera: str, finding: Finding) -> Marker:
    spot = finding.spot
    if spot is None:
        return Marker(camera, None, f"{camera}: {finding.cause}")
    deviation = max(spot.covariance[0, 0], spot.covariance[1, 1]) ** 0.5
    return Marker(camera, (spot.u, spot.v), f"{camera}: {spot.u:.2f}, {spot.v:.2f} px +- {deviation:.3f}")
