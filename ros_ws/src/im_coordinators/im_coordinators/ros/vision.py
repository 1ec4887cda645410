"""Node ``/vision_coordinator``."""

import sys
from typing import Any

from im_core.config import package_file
from im_core.errors import DataError
from im_core.ros import run
from im_core.ros.calls import call
from im_core.ros.status import status_to_error
from im_msgs.msg import CalibrationReport, CameraNames, ObservationSet, SpotSet
from im_msgs.srv import Calibrate, SpotFind
from im_pnt.ros.node import PntNode

from im_coordinators.strategies import LONGER_EXPOSURE, another_look_may_help

SPOT_S = 20.0
CALIBRATION_S = 110.0


class VisionCoordinator(PntNode):
    """Functions and enabling functions of ``nets/vision_coordinator.yaml``; the net decides what comes when."""

    def __init__(self) -> None:
        super().__init__(
            "vision_coordinator",
            [package_file("im_coordinators", "nets/vision_coordinator.yaml")],
            functions={
                "do_find_spot": self.do_find_spot,
                "look_again": self.look_again,
                "do_calibrate": self.do_calibrate,
            },
            guards={
                "another_look_may_help": lambda ctx: another_look_may_help(ctx.failure.facts.get("causes", []))
            },
        )
        self._exposure = self.declare_parameter("exposure", 0.0).value
        self._long_exposure = self.declare_parameter("long_exposure", 0.009 * LONGER_EXPOSURE).value
        self._spot_find = self.create_client(SpotFind, "/vss/spot_find")
        self._calibrate = self.create_client(Calibrate, "/vss/calibrate")

    async def do_find_spot(self, ctx: Any) -> None:
        """Finds the spot in all cameras at the exposure of their configuration."""
        await self._find_spot(self._exposure)

    async def look_again(self, ctx: Any) -> None:
        """Finds the spot at a longer exposure."""
        await self._find_spot(self._long_exposure)

    async def do_calibrate(self, ctx: Any) -> None:
        """Has VSS compute the calibration from the observations in the DOM, and stores it."""
        collected = await self.dom.get("observations", ObservationSet)
        request = Calibrate.Request(
            cameras=collected.cameras,
            observations=collected.observations,
            directory=collected.directory,
            apply=True,
        )
        answer = await call(self, self._calibrate, request, CALIBRATION_S, "a calibration")
        if not answer.success:
            raise status_to_error(answer.status)
        report: CalibrationReport = answer.report
        await self.dom.put("calibration", report, place="vision_coordinator.calibration_stored")

    async def _find_spot(self, exposure: float) -> None:
        wanted = await self.dom.get("calibration_cameras", CameraNames)
        request = SpotFind.Request(cameras=wanted.cameras, exposure=exposure)
        answer = await call(self, self._spot_find, request, SPOT_S, "a spot")
        if not answer.success:
            raise status_to_error(answer.status)
        missed = {spot.camera: spot.cause for spot in answer.spots if not spot.found}
        if len(missed) == len(answer.spots):
            named = "; ".join(f"{camera}: {cause}" for camera, cause in missed.items())
            raise DataError(f"no camera sees {wanted.light}: {named}", code="spot_not_found", causes=[*missed.values()])
        found = SpotSet(spots=answer.spots, timing_json=answer.timing_json)
        await self.dom.put("spots", found, place="vision_coordinator.spot_stored")


def main() -> None:
    """Run ``/vision_coordinator``."""
    sys.exit(run.main(VisionCoordinator))


if __name__ == "__main__":
    main()
