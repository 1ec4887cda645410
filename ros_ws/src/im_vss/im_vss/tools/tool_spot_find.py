"""Tool that computes where the light spot is."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.frames import Frame
from im_vss.spot import SearchDisc, SpotFinding, find_spot
from im_vss.tools.tool import Tool


class ToolSpotFind(Tool):
    """Finds the light in a pair of frames; a calculation, without a Vision Module (paper: toolSpotFind)."""

    name: ClassVar[str] = "tool_spot_find"

    def __call__(self, off: Frame, on: Frame, light: NDArray[np.float64] | None = None) -> SpotFinding:
        """The spot in the difference of two frames of one camera.

        Args:
            off: Frame with the lights strobed off.
            on: Frame with the lights as commanded.
            light: Where the robot's pose put the light when `on` was exposed, shape (3,) [m]; None: not known then.
        """
        sensor = on.controls.of(self.rig.settings.sensor)
        finding = find_spot(on.image, off.image, sensor, self.rig.settings.spot, self._region(on, light))
        if finding.spot is None and not finding.candidates and (why := self.rig.why_dark()):
            return replace(finding, cause=f"no light seen: {why}")
        return finding

    def _region(self, frame: Frame, light: NDArray[np.float64] | None) -> SearchDisc | None:
        """Where the light must be if the robot's pose at the exposure is known and the camera is fixed."""
        entry = self.rig.book[frame.camera]
        light = self.rig.light_position(frame.stamp_ns) if light is None else light
        if light is None or entry.parent != "world":
            return None
        uv = entry.model.project(light)
        radii = self.rig.settings.region
        radius = radii.calibrated if entry.calibrated else radii.nominal
        if not bool(entry.model.contains(uv, margin=-radius)):
            return None
        return SearchDisc(float(uv[0]), float(uv[1]), radius)
