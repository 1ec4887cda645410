"""Node ``/vision_coordinator``."""

import sys
from typing import Any

from im_coordinators.ros.carrier import CAMERAS
from im_coordinators.strategies import another_look_may_help
from im_core.config import package_file
from im_core.errors import DataError, ImError
from im_core.ros import run
from im_msgs.msg import CameraNames, ObservationSet, SpotSet
from im_pnt.functions import woken_by
from im_pnt.ros.node import PntNode


class VisionCoordinator(PntNode):
    """Functions and enabling functions of ``nets/vision_coordinator.yaml``; the net decides what comes when."""

    def __init__(self) -> None:
        super().__init__(
            "vision_coordinator",
            [package_file("im_coordinators", "nets/vision_coordinator.yaml")],
            functions={
                "light": self.light,
                "forget_cameras": self.forget_cameras,
                "nominal_exposure": self.nominal_exposure,
                "longer_exposure": self.longer_exposure,
                "store_spots": self.store_spots,
                "observations": self.observations,
                "store_calibration": self.store_calibration,
            },
            guards={"another_look_may_help": woken_by()(lambda ctx: _mendable(ctx.failure))},
        )
        self._long_exposure = self.declare_parameter("long_exposure", 0.018).value

    async def light(self, ctx: Any) -> dict[str, object]:
        """The light that the cameras are to look for."""
        return {"name": (await self.dom.get(CAMERAS, CameraNames)).light}

    async def forget_cameras(self, ctx: Any, answer: Any) -> None:
        """Ends the calibration: what moves next is no longer to carry its light."""
        await self.dom.invalidate(CAMERAS)

    async def nominal_exposure(self, ctx: Any) -> dict[str, object]:
        """The request for a spot at the exposure of the cameras' configuration."""
        return await self._spot_request(0.0)

    async def longer_exposure(self, ctx: Any) -> dict[str, object]:
        """The request for another look with more light."""
        return await self._spot_request(self._long_exposure)

    async def store_spots(self, ctx: Any, answer: Any) -> None:
        """Stores the spots that were found, if any was."""
        missed = {spot.camera: spot.cause for spot in answer.spots if not spot.found}
        if len(missed) == len(answer.spots):
            named = "; ".join(f"{camera}: {cause}" for camera, cause in missed.items())
            raise DataError(f"no camera sees the light: {named}", code="spot_not_found", causes=[*missed.values()])
        found = SpotSet(spots=answer.spots, timing_json=answer.timing_json)
        await self.dom.put("spots", found, place="vision_coordinator.spot_stored")

    async def observations(self, ctx: Any) -> dict[str, object]:
        """The request for a calibration from the observations in the DOM."""
        collected = await self.dom.get("observations", ObservationSet)
        return {
            "cameras": list(collected.cameras),
            "observations": list(collected.observations),
            "directory": collected.directory,
            "apply": True,
        }

    async def store_calibration(self, ctx: Any, answer: Any) -> None:
        """Stores the calibration."""
        await self.dom.put("calibration", answer.report, place="vision_coordinator.calibration_stored")

    async def _spot_request(self, exposure: float) -> dict[str, object]:
        wanted = await self.dom.get(CAMERAS, CameraNames)
        return {"cameras": list(wanted.cameras), "exposure": exposure}


def _mendable(failure: ImError | None) -> bool:
    causes = failure.facts.get("causes", []) if failure is not None else []
    return isinstance(causes, list) and another_look_may_help(causes)


def main() -> None:
    """Run ``/vision_coordinator``."""
    sys.exit(run.main(VisionCoordinator))


if __name__ == "__main__":
    main()
