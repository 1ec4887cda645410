"""``/<group>/follow_joint_trajectory`` and ``/<group>/joint_trajectory``, as ros2_control's controller has them."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from builtin_interfaces.msg import Time as TimeMessage
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action.server import ServerGoalHandle
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_core.errors import DataError, ImError
from im_core.ros import qos
from im_mcs.client.trajectory import GoalTolerances, TimedTrajectory, Tolerance, Waypoint, trajectory_path
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.ros.motions import Goals, Motions, fail

_Result = FollowJointTrajectory.Result
_ERROR_CODES = {
    "joints": _Result.INVALID_JOINTS,
    "old_stamp": _Result.OLD_HEADER_TIMESTAMP,
    "path_tolerance": _Result.PATH_TOLERANCE_VIOLATED,
    "goal_tolerance": _Result.GOAL_TOLERANCE_VIOLATED,
}


class TrajectoryServer:
    """The action and the topic of every group of every preset; what is new replaces what is under way.

    Args:
        access: MCS.
        motions: Move groups.
    """

    def __init__(self, access: McsAccess, motions: Motions) -> None:
        self._mcs, self._motions = access, motions
        self._goals = Goals(access)
        for group in access.group_names:
            self._goals.serve(FollowJointTrajectory, f"/{group}/follow_joint_trajectory", partial(self._execute, group))
            topic = f"/{group}/joint_trajectory"
            access.node.create_subscription(JointTrajectory, topic, partial(self._take, group, topic), qos.EVENTS)

    async def _execute(self, group: str, handle: ServerGoalHandle) -> _Result:
        result = _Result()
        try:
            await self._motions.run(
                self._arguments(group, _of_goal(handle.request)),
                client=self._goals.client(handle),
                started=partial(self._goals.begin_goal, handle),
                on_progress=partial(self._feedback, group, handle),
            )
        except ImError as error:
            result.error_code = _ERROR_CODES.get(error.code, _Result.INVALID_GOAL)
            result.error_string = error.message
            fail(handle, error)
        else:
            result.error_code = _Result.SUCCESSFUL
            handle.succeed()
        finally:
            self._goals.end_goal(handle)
        return result

    def _take(self, group: str, topic: str, message: JointTrajectory) -> None:
        self._mcs.node.spawn(self._follow(group, topic, message))

    async def _follow(self, group: str, topic: str, message: JointTrajectory) -> None:
        try:
            if message.points:
                await self._motions.run(self._arguments(group, _of_message(message)))
            else:
                self._mcs.group(group)
                await self._motions.stop(group)
        except ImError as error:
            if error.code not in ("cancelled", "replaced"):
                self._mcs.refusals.add(topic, error)

    def _arguments(self, group: str, trajectory: TimedTrajectory) -> dict[str, Any]:
        description = self._mcs.group(group)
        snapshot = self._mcs.client().snapshot()
        index = self._mcs.index(description)
        at_rest = snapshot["setpoint"][index].tolist() if snapshot["at_rest"][index].all() else None
        now_s = int(snapshot["stamp_ns"]) * 1e-9
        path = trajectory_path(group, description.joints, trajectory, now_s, at_rest)
        return {"group": group, "path": path, "policy": "replace", "speed_scale": 0.0}

    def _feedback(self, group: str, handle: ServerGoalHandle, *_: object) -> None:
        snapshot = self._mcs.client().snapshot()
        description = self._mcs.group(group)
        index = self._mcs.index(description)
        message = FollowJointTrajectory.Feedback(joint_names=list(description.joints))
        message.header.stamp = messages.time(int(snapshot["stamp_ns"]))
        names = ("setpoint", "setpoint_v", "setpoint_a")
        wanted = [snapshot[name][index] for name in names]
        actual = [snapshot[name][index] for name in ("q", "v")]
        message.desired = _point(wanted)
        message.actual = _point(actual)
        message.error = _point([a - b for a, b in zip(wanted, actual, strict=False)])
        handle.publish_feedback(message)


def _point(values: Sequence[np.ndarray]) -> JointTrajectoryPoint:
    """A point of positions, velocities and, where there are any, accelerations."""
    point = JointTrajectoryPoint()
    for name, value in zip(("positions", "velocities", "accelerations"), values, strict=False):
        setattr(point, name, value)
    return point


def _of_goal(goal: FollowJointTrajectory.Goal) -> TimedTrajectory:
    for name in ("joint_names", "points"):
        if getattr(goal.multi_dof_trajectory, name):
            raise DataError("multi_dof_trajectory is not empty; the joints here have one degree of freedom each")
    for name in ("component_path_tolerance", "component_goal_tolerance"):
        if getattr(goal, name):
            raise DataError(f"{name} is not empty; the joints here have one degree of freedom each")
    tolerances = GoalTolerances(
        [_tolerance(t) for t in goal.path_tolerance],
        [_tolerance(t) for t in goal.goal_tolerance],
        _seconds(goal.goal_time_tolerance),
    )
    return _of_message(goal.trajectory, tolerances)


def _of_message(message: JointTrajectory, tolerances: GoalTolerances | None = None) -> TimedTrajectory:
    points = [
        Waypoint(_seconds(p.time_from_start), p.positions, p.velocities, p.accelerations, p.effort)
        for p in message.points
    ]
    return TimedTrajectory(
        list(message.joint_names), points, _seconds(message.header.stamp), tolerances or GoalTolerances()
    )


def _tolerance(message: JointTolerance) -> Tolerance:
    return Tolerance(message.name, message.position, message.velocity, message.acceleration)


def _seconds(message: Duration | TimeMessage) -> float:
    return float(message.sec + 1e-9 * message.nanosec)
