"""Node ``/vision_coordinator``."""

import sys

import numpy as np
from std_msgs.msg import String

from im_calibration.light import MeasuredRest, rotation_of
from im_cell.robot import load_cell
from im_coordinators.requests import collected_poses, kept_pose
from im_coordinators.ros.calibration import CAMERAS, cameras_of
from im_coordinators.vision import another_look_may_help, is_lit, require_spot
from im_core import clock
from im_core.config import package_file
from im_core.errors import WaitTimeoutError
from im_core.ros import qos, run
from im_core.ros.calls import pause
from im_msgs.msg import CameraNames, GroupState, Observation, ObservationSet, Rejection, SpotSet
from im_msgs.srv import Calibrate, SetLight, SpotFind
from im_pnt.execution.functions import ActionContext, idempotent, woken_by
from im_pnt.ros.node import PntNode
from im_pnt_analysis import verify_to_load

LIGHTS = "/testbed/lights"
LIGHTS_S, PAUSE_S = 5.0, 0.02
LIGHTS_FOUND = "lights_found"
"""Data object: the lights as they were before the calibration under way."""


class VisionCoordinator(PntNode):
    """Functions and enabling functions of ``nets/vision_coordinator.yaml``; the net decides what comes when."""

    def __init__(self) -> None:
        super().__init__(
            "vision_coordinator",
            [package_file("im_coordinators", "nets/vision_coordinator.yaml")],
            functions={
                "light_on": self.light_on,
                "light_as_found": self.light_as_found,
                "forget_cameras": self.forget_cameras,
                "nominal_exposure": self.nominal_exposure,
                "longer_exposure": self.longer_exposure,
                "store_spots": self.store_spots,
                "keep_observation": self.keep_observation,
                "calibration_problem": self.calibration_problem,
                "store_calibration": self.store_calibration,
            },
            guards={"another_look_may_help": woken_by()(lambda ctx: another_look_may_help(ctx.failure))},
            asks={"keep_observation": idempotent(self.keep_observation)},
            verifier=verify_to_load,
        )
        self.sources.follow(LIGHTS, String, qos.LATCHED, check=lambda message: is_lit(message.data, ""))
        self._long_exposure = self.fixed_parameters.declare(
            "long_exposure", 0.018, "exposure of the second look at a spot that was too faint [s]", span=(0.0, 10.0)
        )
        self._led_offset = np.array(load_cell().led.offset)

    async def light_on(self, ctx: ActionContext) -> dict[str, object]:
        """Has the light on that the cameras are to look for.

        What the lights were is kept first, and once: this is done again where it is in doubt whether it was done.
        """
        if not await self.dom.is_valid(LIGHTS_FOUND):
            await self.dom.put(LIGHTS_FOUND, await self._lights())
        return {"name": (await self.dom.get(CAMERAS, CameraNames)).light, "on": True}

    async def light_as_found(self, ctx: ActionContext) -> dict[str, object]:
        """Has that light as it was before; where it was not touched, as it is."""
        name = (await self.dom.get(CAMERAS, CameraNames)).light
        kept = await self.dom.is_valid(LIGHTS_FOUND)
        lights = await self.dom.get(LIGHTS_FOUND, String) if kept else await self._lights()
        return {"name": name, "on": is_lit(lights.data, name)}

    async def forget_cameras(self, ctx: ActionContext, answer: SetLight.Response) -> None:
        """Ends the calibration: what moves next is no longer to carry its light."""
        if await self.dom.is_valid(LIGHTS_FOUND):
            await self.dom.invalidate(LIGHTS_FOUND)
        await self.dom.invalidate(CAMERAS)

    async def _lights(self) -> String:
        """What the testbed last said of its lights; a coordinator that has just begun waits until it hears it."""
        deadline = clock.monotonic() + LIGHTS_S
        while (message := self.sources.last(LIGHTS)) is None:
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=f"{LIGHTS}, to leave the lights as they are", seconds=LIGHTS_S)
            await pause(self, PAUSE_S)
        found: String = message
        return found

    async def nominal_exposure(self, ctx: ActionContext) -> dict[str, object]:
        """The request for a spot at the exposure of the cameras' configuration."""
        return {"cameras": await cameras_of(ctx, self.dom), "exposure": 0.0}

    async def longer_exposure(self, ctx: ActionContext) -> dict[str, object]:
        """The request for another look with more light."""
        return {"cameras": await cameras_of(ctx, self.dom), "exposure": self._long_exposure}

    async def store_spots(self, ctx: ActionContext, answer: SpotFind.Response) -> None:
        """Stores the spots that were found, if any was."""
        require_spot({spot.camera: spot.cause for spot in answer.spots if not spot.found}, len(answer.spots))
        found = SpotSet(spots=answer.spots, timing_json=answer.timing_json)
        await self.dom.put("spots", found, place="vision_coordinator.spot_stored")

    async def keep_observation(self, ctx: ActionContext) -> None:
        """Keeps spots and position of a pose as an observation, under the number of the pose."""
        kept = kept_pose(ctx.request_arguments)
        spots = await self.dom.get("spots", SpotSet)
        position = await self.dom.get("current_position", GroupState)
        rest = _rest(position)
        for spot in spots.spots:
            rest.require_shown(spot.stamp.sec * 10**9 + spot.stamp.nanosec, kept.pose)
        observation = Observation(
            pose=kept.pose,
            wrist=position.wrist,
            position_covariance=rest.light_covariance(self._led_offset).ravel(),
            spots=spots.spots,
            rest_since=position.rest_since,
        )
        await self.dom.put(f"observation/{kept.number}", observation)

    async def calibration_problem(self, ctx: ActionContext) -> dict[str, object]:
        """The request for a calibration: from the observations that are named, or else from those in the DOM."""
        named = collected_poses(ctx.request_arguments)
        if named is None:
            collected = await self.dom.get("observations", ObservationSet)
        else:
            collected = ObservationSet(
                cameras=named.cameras,
                observations=[await self.dom.get(f"observation/{n}", Observation) for n in named.observations],
                rejected=[Rejection(pose=pose, reason=reason) for pose, reason in named.rejected.items()],
                directory=named.directory,
            )
            await self.dom.put("observations", collected)
        return {
            "cameras": list(collected.cameras),
            "observations": list(collected.observations),
            "directory": collected.directory,
            "apply": True,
        }

    async def store_calibration(self, ctx: ActionContext, answer: Calibrate.Response) -> None:
        """Stores the calibration."""
        await self.dom.put("calibration", answer.report, place="vision_coordinator.calibration_stored")


def _rest(position: GroupState) -> MeasuredRest:
    orientation, n = position.wrist.orientation, len(position.q_rest)
    return MeasuredRest(
        jacobian=np.array(position.jacobian).reshape(6, -1),
        q_covariance=np.array(position.q_rest_covariance).reshape(n, -1),
        rotation=rotation_of(orientation.x, orientation.y, orientation.z, orientation.w),
        since_ns=position.rest_since.sec * 10**9 + position.rest_since.nanosec,
    )


def main() -> None:
    """Run ``/vision_coordinator``."""
    sys.exit(run.main(VisionCoordinator))


if __name__ == "__main__":
    main()
