"""Functions and enabling functions of ``nets/calibrate_camera.yaml``.

All that a command has collected is in its memory (``ctx.memory``) and in data objects, and every function may be done
twice: a dispatcher that died goes on with the command when it is back.
"""

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
from im_core.ros.calls import run_in_thread
from im_dispatcher.expectation import beside, expectation
from im_dispatcher.job import CalibrationJob, check
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
from im_pnt.again import again
from im_pnt.functions import AskFunction, woken_by
from im_pnt.jobs import Job
from im_pnt.ros.node import PntNode
from im_pnt.timed.durations import CommandDuration

SYMBOL = "calibrate_camera"
CEILING = ("ceiling_left", "ceiling_right")


class CalibrateCamera:
    """What the transitions of calibrate_camera do; the net decides what comes when."""

    def __init__(self) -> None:
        self._cell = load_cell()
        self._times = StepTimes()
        self._timed: int | None = None

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
    def asks(self) -> dict[str, AskFunction]:
        """What to do about an action that was interrupted: each may be done twice."""
        return {name: again(action) for name, action in self.functions.items()}

    @property
    def guards(self) -> dict[str, Callable[[Any], bool]]:
        """Enabling functions by the names that the net uses."""
        return {
            "more_poses": woken_by()(lambda ctx: _job(ctx).more_poses()),
            "pose_dispensable": woken_by()(_dispensable),
        }

    def attach(self, node: PntNode) -> None:
        """Tells which node this is part of."""
        self._node = node
        node.create_subscription(Firing, "/pnt/firings", self._note_firing, qos.EVENTS)

    # Actions, in the order of the net.

    async def init_calib(self, ctx: Any) -> None:
        """Reads the poses and sets the loop variable."""
        self._times, self._timed = StepTimes(), ctx.command.id
        ctx.memory["begun"] = [clock.monotonic(), self._now_s()]
        arguments = ctx.command.arguments
        file = load_poses(arguments.get("poses_file", ""))
        poses = list(file.poses)
        cameras = list(arguments.get("cameras") or CEILING)
        check(cameras, poses, list(self._cell.cameras))
        job = CalibrationJob(cameras, poses, str(make_directory(results_dir(), clock.stamp_name())))
        _remember(ctx, job)
        await self._node.dom.put("calibration_cameras", CameraNames(cameras=cameras, light=f"{file.group}_led"))
        await self._node.dom.put("observations", ObservationSet(cameras=cameras, directory=job.directory))
        ctx.progress(f"{len(poses)} poses for {', '.join(cameras)}", 0.0)

    async def read_next_pos(self, ctx: Any) -> None:
        """Counts the loop variable down and stores the next destination."""
        job = _job(ctx)
        pose = job.take()
        _remember(ctx, job)
        ctx.memory["times"] = self._times_of(ctx).to_dict()
        await self._node.dom.put("destination", _stamped(pose), place=f"{SYMBOL}.destination_valid")
        ctx.progress(f"pose {job.taken} of {len(job.poses)} ({pose.name})", job.progress)

    async def keep_observation(self, ctx: Any) -> None:
        """Adds spot and position of this pose to the observations."""
        job = _job(ctx)
        spots = await self._node.dom.get("spots", SpotSet)
        position = await self._node.dom.get("current_position", GroupState)
        observations = []
        try:
            observations.append(self._observation(job.current.name, spots, position))
            job.keep()
        except DataError as error:
            job.skip(error.message)
        await self._store_observations(job, observations)
        _remember(ctx, job)
        ctx.progress(f"{len(job.kept)} observations", job.progress)

    async def skip_pose(self, ctx: Any) -> None:
        """Leaves out this pose and says why."""
        job = _job(ctx)
        job.skip(ctx.failure.message)
        await self._store_observations(job, [])
        _remember(ctx, job)
        ctx.progress(f"pose {job.current.name} skipped: {ctx.failure.message}", job.progress)

    async def write_report(self, ctx: Any) -> None:
        """Writes the report of a calibration that succeeded."""
        calibration = await self._node.dom.get("calibration", CalibrationReport)
        report = json.loads(calibration.json)
        job = _job(ctx)
        report["points_rejected"] = [*report.get("points_rejected", []), *_skipped(job)]
        report["poses"] = len(job.poses)
        ctx.result.update(self._finish(ctx, report, await self._expected(len(job.poses))))

    async def note_failure(self, ctx: Any) -> None:
        """Keeps the reason for which the command ends, before what is done to end it can fail too."""
        reason = "the command was cancelled" if ctx.cancelled else ctx.failure.message
        ctx.memory["reason"] = reason
        ctx.progress(f"giving up: {reason}")

    async def report_failure(self, ctx: Any) -> None:
        """Writes the report of a command that failed."""
        reason = ctx.memory.get("reason") or ctx.failure.message
        ctx.result["message"] = reason
        if "job" in ctx.memory:
            report = {"success": False, "message": reason, "points_used": 0, "points_rejected": _skipped(_job(ctx))}
            self._finish(ctx, report)

    # What they share.

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

    async def _store_observations(self, job: CalibrationJob, new: list[Observation]) -> None:
        """Stores the observations of the poses kept so far; one of the present pose takes the place of an older one."""
        stored = await self._node.dom.get("observations", ObservationSet)
        names = {observation.pose for observation in new}
        collected = ObservationSet(
            cameras=job.cameras,
            observations=[*(seen for seen in stored.observations if seen.pose not in names), *new],
            rejected=[Rejection(pose=skip.pose, reason=skip.reason) for skip in job.skipped],
            directory=job.directory,
        )
        await self._node.dom.put("observations", collected)

    async def _expected(self, poses: int) -> CommandDuration | None:
        """How long the command should have taken; None where its nets do not say."""
        try:
            return await run_in_thread(self._node, expectation, self._node.net_with_servers(SYMBOL), SYMBOL, poses)
        except ImError as error:
            self._node.get_logger().warning(f"no duration is expected: {error.message}")
            return None

    def _finish(self, ctx: Any, report: dict[str, Any], expected: CommandDuration | None = None) -> dict[str, Any]:
        job, times, (begun_s, begun_simulated_s) = _job(ctx), self._times_of(ctx), ctx.memory["begun"]
        simulated_s = self._now_s() - begun_simulated_s
        report["timing"] = times.summary(clock.monotonic() - begun_s, simulated_s)
        if expected is not None:
            report["timing"]["expectation"] = beside(expected, times.steps, simulated_s)
        report["seed"] = self._node.seed
        write_report(Path(job.directory), report)
        return {"report": report, "directory": job.directory}

    def _times_of(self, ctx: Any) -> StepTimes:
        """The times of a command; a dispatcher that came back takes up those of its former life."""
        if self._timed != ctx.command.id:
            self._timed = ctx.command.id
            self._times.add(ctx.memory.get("times", {}))
        return self._times

    def _note_firing(self, message: Firing) -> None:
        name = f"{message.net}.{message.transition}"
        stamp = message.stamp.sec + message.stamp.nanosec * 1e-9
        if message.phase == Firing.START:
            self._times.start(name, stamp)
        elif message.phase in (Firing.END, Firing.FAILED):
            self._times.end(name, stamp, message.duration)

    def _now_s(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9


def standing(command: Job) -> str:
    """How far a command is, for whoever asks in vain for another one."""
    if "job" not in command.memory:
        return "begun"
    job = CalibrationJob.from_dict(command.memory["job"])
    return f"{len(job.kept) + len(job.skipped)} of {len(job.poses)} poses done"


def _job(ctx: Any) -> CalibrationJob:
    if "job" not in ctx.memory:
        raise StateError("no calibrate_camera command is running")
    return CalibrationJob.from_dict(ctx.memory["job"])


def _dispensable(ctx: Any) -> bool:
    return ctx.failure is not None and _job(ctx).dispensable(ctx.failure.code)


def _remember(ctx: Any, job: CalibrationJob) -> None:
    ctx.memory["job"] = job.to_dict()


def _skipped(job: CalibrationJob) -> list[dict[str, str]]:
    return [{"pose": skip.pose, "camera": "", "reason": skip.reason} for skip in job.skipped]


def _stamped(pose: WristPose) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "world"
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = pose.position_m
    orientation.x, orientation.y, orientation.z, orientation.w = pose.orientation_xyzw
    return message
