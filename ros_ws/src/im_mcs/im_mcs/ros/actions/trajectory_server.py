"""``/<group>/follow_joint_trajectory`` and ``/<group>/joint_trajectory``, as with ros2_control's controller."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from control_msgs.action import FollowJointTrajectory
from rclpy.action.server import ServerGoalHandle
from trajectory_msgs.msg import JointTrajectory

from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros.messages.stamps import to_stamp
from im_mcs.client.servo_client import MotionProgress
from im_mcs.client.trajectory import UNSET, Accepted, Present, joint_ranks, trajectory_path
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.ros.actions.motions import Arrival, Goals, Motions, fail
from im_mcs.ros.actions.trajectory_messages import goal_tolerances, timed_trajectory
from im_mcs.ros.bounds import MOST_VALUES, check_length

_Result = FollowJointTrajectory.Result
_ERROR_CODES = {
    "joints": _Result.INVALID_JOINTS,
    "old_stamp": _Result.OLD_HEADER_TIMESTAMP,
    "path_tolerance": _Result.PATH_TOLERANCE_VIOLATED,
    "limited": _Result.PATH_TOLERANCE_VIOLATED,
    "goal_tolerance": _Result.GOAL_TOLERANCE_VIOLATED,
}
_OPTIONS = {
    "allow_partial_joints_goal": "Accept trajectories of some of a group's joints; the others hold. "
    "In force from the next one on.",
    "allow_nonzero_velocity_at_trajectory_end": "Accept trajectories whose last point has a velocity; the motion "
    "decelerates to rest behind it. In force from the next one on.",
}
_GOAL_TIME, _STOPPED = "constraints.goal_time", "constraints.stopped_velocity_tolerance"
_UNNAMED = "where a trajectory names none; 0: the configuration's. In force from the next one on."
_CONSTRAINTS = {
    _GOAL_TIME: (f"Time beyond the end to be there [s] {_UNNAMED}", 1000.0),
    _STOPPED: (f"Largest velocity of a joint at the end [rad/s or m/s] {_UNNAMED}", 10.0),
}


class TrajectoryServer:
    """Action and topic of every group of every preset; a new goal replaces the one under way.

    Parameters: ``allow_partial_joints_goal``, ``allow_nonzero_velocity_at_trajectory_end``, and, below ``constraints``,
    of each joint ``trajectory`` and ``goal``, ``stopped_velocity_tolerance`` and ``goal_time``, as the controller has.
    """

    def __init__(self, access: McsAccess, motions: Motions) -> None:
        self._mcs, self._motions = access, motions
        self._goals = Goals(access)
        for name, what in _OPTIONS.items():
            access.node.declared.declare(name, False, what, changeable=True)
        bounds = dict(_CONSTRAINTS)
        for joint in access.cell.joint_names:
            bounds[f"constraints.{joint}.trajectory"] = f"Largest error on the way [rad or m] {_UNNAMED}", 10.0
            bounds[f"constraints.{joint}.goal"] = f"Largest error at the end [rad or m] {_UNNAMED}", 10.0
        for name, (what, largest) in bounds.items():
            access.node.declared.declare(name, 0.0, what, span=(0.0, largest), changeable=True)
        for group in access.group_names:
            name = f"/{group}/follow_joint_trajectory"
            self._goals.serve(FollowJointTrajectory, name, partial(self._execute, group))
            topic = f"/{group}/joint_trajectory"
            access.node.create_subscription(JointTrajectory, topic, partial(self._take, group, topic), qos.EVENTS)

    @property
    def _accepted(self) -> Accepted:
        partial_joints, end_velocity = (bool(self._mcs.node.get_parameter(name).value) for name in _OPTIONS)
        return Accepted(partial_joints, end_velocity)

    async def _execute(self, group: str, handle: ServerGoalHandle) -> _Result:
        result, arrival = _Result(), self._motions.arrive(group, handle)
        try:
            goal = handle.request
            results = await self._motions.run(
                arrival,
                self._arguments(group, goal.trajectory, goal),
                client=self._goals.client(handle),
                started=partial(self._goals.begin_goal, handle),
                on_progress=partial(self._feedback, group, handle),
            )
        except ImError as error:
            cancelled = error.code == "cancelled" and handle.is_cancel_requested
            result.error_code = _Result.SUCCESSFUL if cancelled else _ERROR_CODES.get(error.code, _Result.INVALID_GOAL)
            result.error_string = error.message
            fail(handle, error)
        else:
            result.error_code = _Result.SUCCESSFUL
            result.error_string = str(results.get("retimed", ""))
            handle.succeed()
        finally:
            self._goals.end_goal(handle)
        return result

    def _take(self, group: str, topic: str, message: JointTrajectory) -> None:
        self._mcs.node.spawn(self._follow(self._motions.arrive(group), topic, message))

    async def _follow(self, arrival: Arrival, topic: str, message: JointTrajectory) -> None:
        """Follow a message of a topic; one without points is a wish to stop."""
        try:
            if message.points:
                await self._motions.run(arrival, self._arguments(arrival.group, message))
            else:
                self._mcs.group(arrival.group)
                await self._motions.stop(arrival)
        except ImError as error:
            if error.code not in ("cancelled", "replaced"):
                self._mcs.refusals.add(topic, error)

    def _arguments(
        self, group: str, message: JointTrajectory, goal: FollowJointTrajectory.Goal | None = None
    ) -> dict[str, Any]:
        """Return the arguments of a request; without a goal, of a message of the topic, perhaps a setpoint of a stream.

        Raises:
            ImError: The trajectory is too long, or cannot be followed.
        """
        check_length(message.points, "the trajectory", self._mcs.config.planning.max_trajectory_points, "points")
        check_length(message.joint_names, "joint_names", MOST_VALUES)
        description = self._mcs.group(group)
        joint_ranks(group, description.joints, message.joint_names, self._accepted)
        trajectory = timed_trajectory(message)
        if goal is not None:
            trajectory = replace(trajectory, tolerances=goal_tolerances(goal))
        snapshot = self._mcs.client().snapshot()
        index = self._mcs.index(description)
        moves = snapshot["setpoint_v"][index].any() or snapshot["setpoint_a"][index].any()
        present = Present(int(snapshot["stamp_ns"]) * 1e-9, snapshot["setpoint"][index], at_rest=not moves)
        path = trajectory_path(group, description.joints, trajectory, present, self._accepted, stream=goal is None)
        if "stream" not in path:
            self._constrain(description.joints, path)
        return {"group": group, "path": path, "policy": "replace", "speed_scale": 0.0}

    def _constrain(self, joints: Sequence[str], path: dict[str, Any]) -> None:
        """Fill in the tolerances of the parameters where a trajectory has none."""

        def parameter(name: str) -> float:
            return float(self._mcs.node.get_parameter(name).value)

        for field, names in (
            ("path_tolerance", [f"constraints.{joint}.trajectory" for joint in joints]),
            ("goal_tolerance", [f"constraints.{joint}.goal" for joint in joints]),
            ("goal_velocity_tolerance", [_STOPPED] * len(joints)),
        ):
            given = path[field] or [UNSET] * len(joints)
            path[field] = [value or parameter(name) for value, name in zip(given, names, strict=True)]
        path["goal_time_tolerance"] = path["goal_time_tolerance"] or parameter(_GOAL_TIME)

    def _feedback(self, group: str, handle: ServerGoalHandle, _: MotionProgress) -> None:
        """Publish desired and actual motion of a tick, with place on the requested motion and time since the begin."""
        snapshot = self._mcs.client().snapshot()
        description = self._mcs.group(group)
        index = self._mcs.index(description)
        place_s, since_s = float(snapshot["place_s"][index[0]]), float(snapshot["since_s"][index[0]])
        if since_s == 0.0:
            return  # the motion has ended meanwhile
        message = FollowJointTrajectory.Feedback(joint_names=list(description.joints))
        message.header.stamp = to_stamp(int(snapshot["stamp_ns"]))
        wanted = [snapshot[name][index] for name in ("setpoint", "setpoint_v", "setpoint_a")]
        actual = [snapshot[name][index] for name in ("q", "v")]
        message.desired = messages.trajectory_point(wanted)
        message.actual = messages.trajectory_point(actual)
        message.error = messages.trajectory_point([a - b for a, b in zip(wanted, actual, strict=False)])
        message.desired.time_from_start = messages.duration(place_s)
        message.actual.time_from_start = messages.duration(since_s)
        message.error.time_from_start = messages.duration(place_s - since_s)
        handle.publish_feedback(message)
