"""Functions and enabling functions of ``nets/calibrate_camera.yaml``."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped

from im_core import clock
from im_core.errors import DataError, ImError, StateError
from im_core.names import results_dir
from im_core.robot import load_cell
from im_core.ros import qos
from im_dispatcher.job import CalibrationJob
from im_dispatcher.observation import check_same_rest, light_covariance, rotation_of
from im_dispatcher.poses_file import WristPose, load_poses
from im_dispatcher.report import StepTimes, make_directory, write_report
from im_msgs.msg import (
    CalibrationReport,
    CameraNames,
    Firing,
    GroupState,
    Observation,
    ObservationSet,
    Rejection,
    SpotSet,
)
from im_pnt.ros.node import PntNode

SYMBOL = "calibrate_camera"
CEILING = ("ceiling_left", "ceiling_right")


class CalibrateCamera:
    """What the transitions of calibrate_camera do; the net decides what comes when."""

    def __init__(self) -> None:
        self._cell = load_cell()
        self._job: CalibrationJob[Observation] | None = None
        self._directory: Path | None = None
        self._reason = ""
        self._times = StepTimes()
        self._begun = (0.0, 0.0)

    @property
    def functions(self) -> dict[str, Callable[..., object]]:
        """Actions by the names that the net uses."""
        actions = (
            self.init_calib,
            self.read_next_pos,
            self.keep_observation,
            self.skip_pose,
            self.write_report,
            self.note_failure,
            self.report_failure,
        )
        return {action.__name__: action for action in actions}

    @property
    def guards(self) -> dict[str, Callable[[Any], bool]]:
        """Enabling functions by the names that the net uses."""
        return {
            "more_poses": lambda _: self._job is not None and self._job.more_poses(),
            "pose_dispensable": lambda ctx: self._dispensable(ctx.failure),
        }

    def attach(self, node: PntNode) -> None:
        """Tells which node this is part of."""
        self._node = node
        node.create_subscription(Firing, "/pnt/firings", self._note_firing, qos.EVENTS)

    def standing(self) -> str:
        """How far the command is, for whoever asks in vain for another one."""
        if self._job is None:
            return "being prepared"
        done = len(self._job.observations) + len(self._job.skipped)
        return f"{done} of {len(self._job.poses)} poses done"

    # Actions, in the order of the net.

    async def init_calib(self, ctx: Any) -> None:
        """Reads the poses and sets the loop variable."""
        self._job, self._directory, self._reason = None, None, ""
        self._times = StepTimes()
        self._begun = (clock.monotonic(), self._now_s())
        arguments = ctx.command.arguments
        poses = load_poses(arguments.get("poses_file", "")).poses
        cameras = list(arguments.get("cameras") or CEILING)
        self._job = CalibrationJob(cameras=cameras, poses=poses, known_cameras=list(self._cell.cameras))
        self._directory = make_directory(results_dir(), clock.stamp_name())
        await self._node.dom.put("calibration_cameras", CameraNames(cameras=cameras, light=self._cell.light_names[0]))
        ctx.progress(f"{len(poses)} poses for {', '.join(cameras)}", 0.0)

    async def read_next_pos(self, ctx: Any) -> None:
        """Counts the loop variable down and stores the next destination."""
        job = self._present_job()
        pose = job.take()
        await self._node.dom.put("destination", _stamped(pose), place=f"{SYMBOL}.destination_valid")
        ctx.progress(f"pose {job.taken} of {len(job.poses)} ({pose.name})", job.progress)

    async def keep_observation(self, ctx: Any) -> None:
        """Adds spot and position of this pose to the observations."""
        job = self._present_job()
        spots = await self._node.dom.get("spots", SpotSet)
        position = await self._node.dom.get("current_position", GroupState)
        try:
            job.keep(self._observation(job.current.name, spots, position))
        except DataError as error:
            job.skip(error.message)
        await self._publish_observations(job)
        ctx.progress(f"{len(job.observations)} observations", job.progress)

    async def skip_pose(self, ctx: Any) -> None:
        """Leaves out this pose and says why."""
        job = self._present_job()
        job.skip(ctx.failure.message)
        await self._publish_observations(job)
        ctx.progress(f"pose {job.current.name} skipped: {ctx.failure.message}", job.progress)

    async def write_report(self, ctx: Any) -> None:
        """Writes the report of a calibration that succeeded."""
        calibration = await self._node.dom.get("calibration", CalibrationReport)
        report = json.loads(calibration.json)
        job = self._present_job()
        report["points_rejected"] = [*report.get("points_rejected", []), *_skipped(job)]
        report["poses"] = len(job.poses)
        ctx.result.update(self._finish(report))

    async def note_failure(self, ctx: Any) -> None:
        """Keeps the reason for which the command ends, before what is done to end it can fail too."""
        self._reason = "the command was cancelled" if ctx.cancelled else ctx.failure.message
        ctx.progress(f"giving up: {self._reason}")

    async def report_failure(self, ctx: Any) -> None:
        """Writes the report of a command that failed."""
        reason = self._reason or ctx.failure.message
        ctx.result["message"] = reason
        if self._directory is not None:
            rejected = _skipped(self._job) if self._job is not None else []
            self._finish({"success": False, "message": reason, "points_used": 0, "points_rejected": rejected})

    # What they share.

    def _present_job(self) -> CalibrationJob[Observation]:
        if self._job is None:
            raise StateError("no calibrate_camera command is running")
        return self._job

    def _dispensable(self, failure: ImError | None) -> bool:
        return self._job is not None and failure is not None and self._job.dispensable(failure.code)

    def _observation(self, pose: str, spots: SpotSet, position: GroupState) -> Observation:
        rest_ns = position.rest_since.sec * 10**9 + position.rest_since.nanosec
        for spot in spots.spots:
            check_same_rest(spot.stamp.sec * 10**9 + spot.stamp.nanosec, rest_ns, pose)
        n = len(position.q_rest)
        quaternion = position.wrist.orientation
        covariance = light_covariance(
            np.array(position.jacobian).reshape(6, -1),
            np.array(position.q_rest_covariance).reshape(n, -1),
            rotation_of(quaternion.x, quaternion.y, quaternion.z, quaternion.w),
            np.array(self._cell.led.offset),
        )
        return Observation(
            pose=pose,
            wrist=position.wrist,
            position_covariance=covariance.ravel(),
            spots=spots.spots,
            rest_since=position.rest_since,
        )

    async def _publish_observations(self, job: CalibrationJob[Observation]) -> None:
        collected = ObservationSet(
            cameras=list(job.cameras),
            observations=job.observations,
            rejected=[Rejection(pose=skip.pose, reason=skip.reason) for skip in job.skipped],
            directory=str(self._directory),
        )
        await self._node.dom.put("observations", collected)

    def _finish(self, report: dict[str, Any]) -> dict[str, Any]:
        wall, simulated = clock.monotonic() - self._begun[0], self._now_s() - self._begun[1]
        report["timing"] = self._times.summary(wall, simulated)
        report["seed"] = self._node.seed
        write_report(self._directory, report)
        return {"report": report, "directory": str(self._directory)}

    def _note_firing(self, message: Firing) -> None:
        name = f"{message.net}.{message.transition}"
        stamp = message.stamp.sec + message.stamp.nanosec * 1e-9
        if message.phase == Firing.START:
            self._times.start(name, stamp)
        else:
            self._times.end(name, stamp, message.duration)

    def _now_s(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9


def _skipped(job: CalibrationJob[Observation]) -> list[dict[str, str]]:
    return [{"pose": skip.pose, "camera": "", "reason": skip.reason} for skip in job.skipped]


def _stamped(pose: WristPose) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "world"
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = pose.position_m
    orientation.x, orientation.y, orientation.z, orientation.w = pose.orientation_xyzw
    return message
