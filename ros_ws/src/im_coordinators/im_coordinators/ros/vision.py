"""Node ``/vision_coordinator``."""

import math
import sys
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3
from numpy.typing import NDArray
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage

from im_calibration.light import MeasuredRest
from im_cell.calibration_files import frame_of
from im_cell.lights import lights_told
from im_cell.robot import kinematic_derivatives, load_cell
from im_cell.rotations import cross_matrix, matrix_of_quaternion
from im_coordinators.object_search import middle_covariance, printed_body, standing_place
from im_coordinators.ros.coordinator import Coordinator
from im_coordinators.ros.establishment import Establishment
from im_coordinators.vision import require_spot
from im_core import clock
from im_core.errors import DataError, StateError, WaitTimeoutError
from im_core.ros import qos, run
from im_core.text.bounded_json import read_data
from im_msgs.msg import GroupState, Observation, ObservationSet, Rejection, Spot, SpotSet, TargetView
from im_msgs.srv import Calibrate, FiducialPose, SetLight, SpotFind
from im_pnt.execution.functions import ActionContext, Functions, idempotent
from im_pnt_node.rerun.host import Host

LIGHTS, FRAMES = "/testbed/lights", "/tf_static"
LONG_EXPOSURE, LIGHTS_OF = "long_exposure", "lights_of"
TOLD_S, PAUSE_S = 5.0, 0.02
LIGHT_FOUND = "light_found/"
"""Begins the name of a data object: whether a light was on before the command switched it on."""


class VisionCoordinator(Coordinator):
    """Runs ``nets/vision_coordinator.yaml``."""

    def __init__(self) -> None:
        super().__init__("vision_coordinator", vision_functions)
        cell = load_cell()
        self.sources.follow(LIGHTS, String, qos.LATCHED, check=lambda message: lights_told(message.data, cell))
        frames = {frame_of(camera) for camera in cell.cameras}
        self.sources.follow(
            FRAMES,
            TFMessage,
            qos.LATCHED_MANY,
            check=lambda message: any(each.child_frame_id in frames for each in message.transforms),
        )
        self.declared.declare(
            LONG_EXPOSURE, 0.018, "exposure of the second look at a spot that was too faint [s]", span=(0.0, 10.0)
        )
        self.declared.declare(LIGHTS_OF, "testbed", "task that switches lights; empty: a driver outside the machine")


def vision_functions(host: Host) -> Functions:
    """Return the functions and enabling functions of the net, for a node or a substitute."""
    vision = VisionFunctions(host)
    functions = (
        vision.light_on,
        vision.light_as_found,
        vision.forget_light,
        vision.look_exposure,
        vision.nominal_exposure,
        vision.longer_exposure,
        vision.store_spots,
        vision.keep_observation,
        vision.wanted_print,
        vision.locate_object,
        vision.calibration_problem,
        vision.store_calibration,
    )
    return Functions(
        {function.__name__: function for function in functions},
        {},
        {"keep_observation": idempotent(vision.keep_observation)},
    )


class VisionFunctions:
    """Functions of ``nets/vision_coordinator.yaml``; the net decides the order."""

    def __init__(self, host: Host) -> None:
        self._host, self._cell = host, load_cell()
        self._led_offset = np.array(self._cell.led.offset)

    @property
    def _lit(self) -> Establishment:
        return Establishment(self._host, str(self._host.parameter(LIGHTS_OF)), "lit")

    async def light_on(self, ctx: ActionContext) -> dict[str, object]:
        """Has a light on.

        How it was is kept first, and once: this is done again where it is in doubt whether it was done.
        """
        name = _light(ctx)
        if not await self._host.dom.is_valid(found := ctx.object(LIGHT_FOUND + name)):
            await self._host.dom.put(found, Bool(data=await self._is_lit(name)))
        await self._lit.note(ctx, name)
        return {"name": name, "on": True}

    async def light_as_found(self, ctx: ActionContext) -> dict[str, object]:
        """Return the request to restore a light; a light not touched by the command stays unchanged."""
        name = _light(ctx)
        if await self._host.dom.is_valid(found := ctx.object(LIGHT_FOUND + name)):
            return {"name": name, "on": bool((await self._host.dom.get(found, Bool)).data)}
        return {"name": name, "on": await self._is_lit(name)}

    async def forget_light(self, ctx: ActionContext, answer: SetLight.Response) -> None:
        """Drop the notes of a light restored: the next action finds the original state."""
        await self._lit.forget(ctx, _light(ctx))
        if await self._host.dom.is_valid(found := ctx.object(LIGHT_FOUND + _light(ctx))):
            await self._host.dom.invalidate(found)

    def wanted_print(self, ctx: ActionContext) -> dict[str, object]:
        """Return the request for the print on the object of the request, if the cell has it."""
        _, number = printed_body(self._cell, str(ctx.request_arguments["name"]))
        return {"cameras": [ctx.request_arguments["camera"]], "ids": [number]}

    async def locate_object(self, ctx: ActionContext, answer: FiducialPose.Response) -> None:
        """Return the place in the world of the object of the request, by camera and wrist, and the certainty.

        ``sd`` is the standard deviation along the least certain direction, by image, lens and joints, and by the usual
        errors of an arm's kinematics [m].

        Raises:
            DataError: It was not seen (code ``not_found``), or does not stand upright, or the arm moved.
        """
        name, camera = str(ctx.request_arguments["name"]), str(ctx.request_arguments["camera"])
        if not answer.fiducials:
            text = f"'{name}' was not found: {answer.cause}"
            raise DataError(text, code="not_found", object=name, camera=camera)
        position = await self._host.dom.get(ctx.object("current_position"), GroupState)
        frames = await self._heard(FRAMES, "to know where the camera is on the arm")
        mounted = next(each for each in frames.transforms if each.child_frame_id == frame_of(camera))
        body, _ = printed_body(self._cell, name)
        seen, moved, wrist = answer.fiducials[0].pose, mounted.transform, position.wrist
        rest = _rest(position)
        rest.require_shown(seen.header.stamp.sec * 10**9 + seen.header.stamp.nanosec, name)
        print_camera, top = _placed(seen.pose.pose.position, seen.pose.pose.orientation)
        camera_wrist, mount = _placed(moved.translation, moved.rotation)
        wrist_world, origin = _placed(wrist.position, wrist.orientation)
        in_wrist, camera_world = camera_wrist @ top + mount, wrist_world @ camera_wrist
        spread = middle_covariance(body, print_camera, np.array(seen.pose.covariance).reshape(6, 6))
        by_arm = self._by_arm(position, in_wrist)
        spread = camera_world @ spread @ camera_world.T + rest.point_covariance(in_wrist) + by_arm @ by_arm.T
        place = standing_place(body, camera_world @ print_camera, wrist_world @ in_wrist + origin)
        ctx.result.update(zip(("x", "y", "z", "yaw"), place, strict=True))
        ctx.result["sd"] = float(np.sqrt(np.linalg.eigvalsh(spread)[-1]))

    def _by_arm(self, position: GroupState, offset: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives of a place in the wrist by errors of the arm, each of its usual size, (3, k) [m]."""
        at = dict(zip(position.joints, position.q_rest, strict=True))
        return kinematic_derivatives(self._cell, self._cell.groups[position.group].tip, at, offset)

    def _wrist_by_arm(self, position: GroupState, rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives of place and turn of the wrist, likewise, shape (6, k) [m], [rad].

        The turn is that of three points at a unit's distance: the sum of r x (w x r) over them is 2 w.
        """
        place, *points = (self._by_arm(position, offset) for offset in (np.zeros(3), *np.eye(3)))
        turns = [cross_matrix(arm) @ (point - place) for arm, point in zip(rotation.T, points, strict=True)]
        return np.vstack((place, 0.5 * np.sum(turns, axis=0)))

    async def _heard(self, topic: str, purpose: str) -> Any:
        """Return the last message of a topic; a coordinator just started waits for the first one."""
        deadline = clock.monotonic() + TOLD_S
        while (message := self._host.last(topic)) is None:
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=f"{topic}, {purpose}", seconds=TOLD_S)
            await self._host.pause(PAUSE_S)
        return message

    async def _is_lit(self, name: str) -> bool:
        """Return whether a light is on; a light unknown to the cell is off."""
        return lights_told((await self._heard(LIGHTS, "to leave the lights as they are")).data, self._cell).get(
            name, False
        )

    async def look_exposure(self, ctx: ActionContext) -> dict[str, object]:
        """Return the request for a look, at a light switched on, or at a target."""
        await self._require_shown(ctx)
        exposure = self._host.parameter(LONG_EXPOSURE) if ctx.request_arguments["longer"] else 0.0
        return {**_of(ctx, "cameras", "target"), "exposure": exposure}

    async def nominal_exposure(self, ctx: ActionContext) -> dict[str, object]:
        """Return the request for a spot as received."""
        await self._require_shown(ctx)
        return _of(ctx, "cameras", "exposure", "look", "target")

    async def longer_exposure(self, ctx: ActionContext) -> dict[str, object]:
        """Return the request for a look with more light."""
        await self._require_shown(ctx)
        return {**_of(ctx, "cameras", "target"), "exposure": self._host.parameter(LONG_EXPOSURE)}

    async def _require_shown(self, ctx: ActionContext) -> None:
        """Check that the light is on; a look at a target needs none."""
        if not ctx.request_arguments["target"]:
            await self._lit.require(ctx, _light(ctx))
            await self._require_lit(_light(ctx))

    async def _require_lit(self, name: str) -> None:
        """Wait until the testbed reports a light as on; the light may have been switched just now.

        Raises:
            StateError: It says that it is off.
        """
        deadline = clock.monotonic() + TOLD_S
        while not await self._is_lit(name):
            if clock.monotonic() > deadline:
                raise StateError(f"light {name} is off; no camera can find it before light_on", light=name)
            await self._host.pause(PAUSE_S)

    async def store_spots(self, ctx: ActionContext, answer: SpotFind.Response) -> None:
        """Store spots or views, of a light if the light was on all the time; return the largest error of spots."""
        target = str(ctx.request_arguments["target"])
        seen: list[Spot | TargetView] = [*answer.spots, *answer.views]
        if not target:
            await self._lit.require(ctx, _light(ctx))
        missed = {each.camera: each.cause for each in seen if not each.found}
        require_spot(missed, len(seen), f"'{target}'" if target else "the light")
        ctx.result["off"] = _farthest_off(answer)
        found = SpotSet(spots=answer.spots, views=answer.views, timing_json=answer.timing_json)
        await self._host.dom.put(ctx.object("spots"), found, place="vision_coordinator.spot_stored")

    async def keep_observation(self, ctx: ActionContext) -> None:
        """Store spots and position of a pose as an observation, under the number of the pose."""
        asked = ctx.request_arguments
        pose = str(asked["pose"])
        spots = await self._host.dom.get(ctx.object("spots"), SpotSet)
        position = await self._host.dom.get(ctx.object("current_position"), GroupState)
        rest = _rest(position)
        for stamp in [*(spot.stamp for spot in spots.spots), *(view.stamp for view in spots.views)]:
            rest.require_shown(stamp.sec * 10**9 + stamp.nanosec, pose)
        observation = Observation(pose=pose, wrist=position.wrist, rest_since=position.rest_since)
        if spots.views:
            observation.views = spots.views
            observation.wrist_covariance = rest.wrist_covariance().ravel()
            observation.arm_jacobian = self._wrist_by_arm(position, rest.rotation).ravel()
        else:
            observation.spots = spots.spots
            observation.position_covariance = rest.point_covariance(self._led_offset).ravel()
            observation.arm_jacobian = self._by_arm(position, self._led_offset).ravel()
        await self._host.dom.put(ctx.object(f"observation/{asked['number']}"), observation)

    async def calibration_problem(self, ctx: ActionContext) -> dict[str, object]:
        """Return the request for a calibration from stored observations."""
        asked = ctx.request_arguments
        numbers = read_data(list[int], asked["observations"], "argument observations")
        reasons = read_data(dict[str, str], asked["rejected"], "argument rejected")
        kept = [await self._host.dom.get(ctx.object(f"observation/{number}"), Observation) for number in numbers]
        rejected = [Rejection(pose=pose, reason=reason) for pose, reason in reasons.items()]
        cameras, directory = read_data(list[str], asked["cameras"], "argument cameras"), str(asked["directory"])
        collected = ObservationSet(cameras=cameras, observations=kept, rejected=rejected, directory=directory)
        await self._host.dom.put(ctx.object("/observations"), collected)
        told = {"cameras": cameras, "observations": kept, "directory": directory, "apply": True}
        return {**told, "target": asked["target"]}

    async def store_calibration(self, ctx: ActionContext, answer: Calibrate.Response) -> None:
        """Store the calibration."""
        name, place = ctx.object("calibration"), "vision_coordinator.calibration_stored"
        await self._host.dom.put(name, answer.report, place=place)


def _farthest_off(answer: SpotFind.Response) -> float:
    """Return the largest distance of a spot from the predicted place [px]; -1 without a prediction."""
    pairs = zip(answer.spots, answer.candidates, strict=False)  # a camera without candidates has no prediction
    off = [math.hypot(s.u - c.u, s.v - c.v) for s, c in pairs if s.found and c.predicted]
    return max(off, default=-1.0)


def _of(ctx: ActionContext, *names: str) -> dict[str, object]:
    return {name: ctx.request_arguments[name] for name in names}


def _light(ctx: ActionContext) -> str:
    return str(ctx.request_arguments["light"])


def _placed(at: Point | Vector3, turn: Quaternion) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return matrix_of_quaternion([turn.x, turn.y, turn.z, turn.w]), np.array([at.x, at.y, at.z])


def _rest(position: GroupState) -> MeasuredRest:
    q, n = position.wrist.orientation, len(position.q_rest)
    return MeasuredRest(
        jacobian=np.array(position.jacobian).reshape(6, -1),
        q_covariance=np.array(position.q_rest_covariance).reshape(n, -1),
        rotation=matrix_of_quaternion([q.x, q.y, q.z, q.w]),
        since_ns=position.rest_since.sec * 10**9 + position.rest_since.nanosec,
    )


def main() -> None:
    """Run ``/vision_coordinator``."""
    sys.exit(run.main(VisionCoordinator))


if __name__ == "__main__":
    main()
