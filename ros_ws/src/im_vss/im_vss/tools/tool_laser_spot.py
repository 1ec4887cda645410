"""Tool that finds the laser's spot."""

from dataclasses import replace
from typing import ClassVar

from im_cell.frames import Frame
from im_vss.spot import SpotFinding, SpotFit, find_spot
from im_vss.tools.tool import Tool


class ToolLaserSpot(Tool):
    """Finds the spot in a pair of frames; a calculation, without a Vision Module."""

    name: ClassVar[str] = "tool_laser_spot"

    def __call__(self, off: Frame, on: Frame) -> SpotFinding:
        """The spot in the difference of two frames of one camera.

        Speckle is noise that the sensor's data sheet does not know: where the fit is worse than it says, the covariance
        is larger by as much.

        Args:
            off: Frame with the laser strobed off.
            on: Frame with it.
        """
        settings = self.rig.settings
        finding = find_spot(on.image, off.image, on.controls.of(settings.sensor), settings.spot)
        spot = None if finding.spot is None else _with_speckle(finding.spot)
        return replace(finding, spot=spot, candidates=tuple(map(_with_speckle, finding.candidates)))


def _with_speckle(spot: SpotFit) -> SpotFit:
    return replace(spot, covariance=spot.covariance * max(1.0, spot.chi2_per_dof))
