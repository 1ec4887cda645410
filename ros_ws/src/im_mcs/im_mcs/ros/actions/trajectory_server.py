"""``/<group>/follow_joint_trajectory`` and ``/<group>/joint_trajectory``, as with ros2_control's controller."""

import itertools
from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from rclpy.action.server import ServerGoalHandle
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_core import names
from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros.calls import run_in_thread
from im_core.shm import SharedBlock
from im_mcs.client.servo_client import MotionProgress
from im_mcs.client.trajectory import (
    Accepted,
    Course,
    GoalTolerances,
    Present,
    TimedTrajectory,
    joint_ranks,
    trajectory_path,
)
from im_mcs.client.wire import UUID_BYTES, CdrReader, check_points, read_head, read_tolerances, read_trajectory
from im_mcs.protocol.points import share_points
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.ros.actions.goal_bytes import GoalBytes, with_goals_as_bytes
from im_mcs.ros.actions.motions import Arrival, Goals, Motions, fail

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
# up to here the points of a trajectory are read at once and sent as they are; they are what is shown of longer ones
_FEW = 200


@dataclass(frozen=True)
class _Asked:
    """A trajectory, ready to be sent.

    Attributes:
        course: What to follow.
        path: The other fields of the path.
    """

    course: Course
    path: dict[str, Any]

    @property
    def shown(self) -> dict[str, Any]:
        """The path, with every so many points of a long one."""
        course, many = self.course, len(self.course.times)
        if many > _FEW:
            every = np.linspace(0, many - 1, _FEW).astype(np.intp)
            v, a = (None if x is None else x[every] for x in (course.v, course.a))
            course = Course(course.times[every], course.q[every], v, a)
        return {**self.path, "points": course.points()}


class TrajectoryServer:
    """Action and topic of every group of every preset; a new goal replaces the one under way.

    Parameters: ``allow_partial_joints_goal``, ``allow_nonzero_velocity_at_trajectory_end``, as the controller has them.

    Args:
        access: MCS.
        motions: Move groups.
    """

    def __init__(self, access: McsAccess, motions: Motions) -> None:
        self._mcs, self._motions = access, motions
        self._goals = Goals(access)
        self._numbers = itertools.count(1)
        for name, what in _OPTIONS.items():
            access.node.declared.declare(name, False, what, changeable=True)
        action = with_goals_as_bytes(FollowJointTrajectory, lambda: self._most_points)
        for group in access.group_names:
            self._goals.serve(action, f"/{group}/follow_joint_trajectory", partial(self._execute, group))
            topic = f"/{group}/joint_trajectory"
            access.node.create_subscription(
                JointTrajectory, topic, partial(self._take, group, topic), qos.EVENTS, raw=True
            )

    @property
    def _accepted(self) -> Accepted:
        partial_joints, end_velocity = (bool(self._mcs.node.get_parameter(name).value) for name in _OPTIONS)
        return Accepted(partial_joints, end_velocity)

    @property
    def _most_points(self) -> int:
        return self._mcs.config.planning.max_trajectory_points

    async def _execute(self, group: str, handle: ServerGoalHandle) -> _Result:
        result, arrival = _Result(), self._motions.arrive(group, handle)
        try:
            goal: GoalBytes = handle.request
            check_points(goal.points, self._most_points)
            asked = await self._read(group, CdrReader(goal.data, UUID_BYTES), is_goal=True)
            assert asked is not None
            results = await self._run(
                arrival,
                asked,
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

    def _take(self, group: str, topic: str, message: bytes) -> None:
        self._mcs.node.spawn(self._follow(self._motions.arrive(group), topic, message))

    async def _follow(self, arrival: Arrival, topic: str, message: bytes) -> None:
        try:
            asked = await self._read(arrival.group, CdrReader(message), is_goal=False)
            if asked is None:
                await self._motions.stop(arrival)
            else:
                await self._run(arrival, asked)
        except ImError as error:
            if error.code not in ("cancelled", "replaced"):
                self._mcs.refusals.add(topic, error)

    async def _read(self, group: str, cdr: CdrReader, *, is_goal: bool) -> _Asked | None:
        """Read a goal; a long trajectory in a thread, so the node goes on.

        Returns:
            The trajectory, or None if a message on the topic has no points: a wish to stop.
        """
        description = self._mcs.group(group)
        head = read_head(cdr, self._most_points)
        if not is_goal and not head.points:
            return None
        joint_ranks(group, description.joints, head.joints, self._accepted)

        def read() -> _Asked:
            trajectory = read_trajectory(cdr, head)
            tolerances = read_tolerances(cdr) if is_goal else GoalTolerances()
            return self._asked(group, replace(trajectory, tolerances=tolerances), stream=not is_goal)

        return read() if head.points <= _FEW else await run_in_thread(self._mcs.node, read)

    def _asked(self, group: str, trajectory: TimedTrajectory, *, stream: bool) -> _Asked:
        description = self._mcs.group(group)
        snapshot = self._mcs.client().snapshot()
        index = self._mcs.index(description)
        present = Present(
            int(snapshot["stamp_ns"]) * 1e-9, snapshot["setpoint"][index], bool(snapshot["at_rest"][index].all())
        )
        return _Asked(*trajectory_path(group, description.joints, trajectory, present, self._accepted, stream=stream))

    async def _run(self, arrival: Arrival, asked: _Asked, **told: Any) -> dict[str, Any]:
        """Have a trajectory followed, and await the end; ``told`` is for :meth:`Motions.run`."""
        many = len(asked.course.times) > _FEW
        block, points = await run_in_thread(self._mcs.node, self._share, asked.course) if many else (None, None)
        shown = asked.shown
        path = {**shown, "points": points} if many else shown
        arguments = {"group": arrival.group, "path": path, "policy": "replace", "speed_scale": 0.0}
        with nullcontext() if block is None else closing(block):
            return await self._motions.run(arrival, arguments, path=shown, **told)

    def _share(self, course: Course) -> tuple[SharedBlock, dict[str, Any]]:
        name = f"{names.instance()}_mcs_points_{next(self._numbers)}"
        return share_points(name, course)

    def _feedback(self, group: str, handle: ServerGoalHandle, progress: MotionProgress) -> None:
        """Publish desired and actual motion, with place on the requested motion and time since the begin."""
        snapshot = self._mcs.client().snapshot()
        description = self._mcs.group(group)
        index = self._mcs.index(description)
        message = FollowJointTrajectory.Feedback(joint_names=list(description.joints))
        message.header.stamp = messages.time(int(snapshot["stamp_ns"]))
        wanted = [snapshot[name][index] for name in ("setpoint", "setpoint_v", "setpoint_a")]
        actual = [snapshot[name][index] for name in ("q", "v")]
        message.desired = _point(wanted)
        message.actual = _point(actual)
        message.error = _point([a - b for a, b in zip(wanted, actual, strict=False)])
        message.desired.time_from_start = messages.duration(progress.place_s)
        message.actual.time_from_start = messages.duration(progress.time_s)
        message.error.time_from_start = messages.duration(progress.place_s - progress.time_s)
        handle.publish_feedback(message)


def _point(values: Sequence[np.ndarray]) -> JointTrajectoryPoint:
    """Return a point of positions, velocities and, where there are any, accelerations."""
    point = JointTrajectoryPoint()
    for name, value in zip(("positions", "velocities", "accelerations"), values, strict=False):
        setattr(point, name, value)
    return point
