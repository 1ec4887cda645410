"""``/<group>/move``: joint-interpolated motion, and lines and arcs of the wrist."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import Pose
from rclpy.action.server import ServerGoalHandle

from im_core.errors import DataError, ImError
from im_core.ros.messages.stamps import to_stamp
from im_core.ros.messages.status import ok_status, to_status
from im_mcs.client.groups import group_state
from im_mcs.client.kinematics import wrist_pose
from im_mcs.client.points import ordered_points
from im_mcs.client.servo_client import MotionProgress
from im_mcs.ros import messages
from im_mcs.ros.access import McsAccess
from im_mcs.ros.actions.motions import Goals, Motions, fail
from im_msgs.action import Move

_POLICIES = {Move.Goal.REFUSE: "refuse", Move.Goal.APPEND: "append", Move.Goal.REPLACE: "replace"}


class MoveServer:
    """``/<group>/move`` of every group of every preset."""

    def __init__(self, access: McsAccess, motions: Motions) -> None:
        self._mcs, self._motions = access, motions
        self._goals = Goals(access)
        for group in access.group_names:
            self._goals.serve(Move, f"/{group}/move", partial(self._execute, group))

    async def _execute(self, group: str, handle: ServerGoalHandle) -> Move.Result:
        result, arrival = Move.Result(), self._motions.arrive(group, handle)
        try:
            results = await self._motions.run(
                arrival,
                self._arguments(group, handle.request),
                client=self._goals.client(handle),
                started=partial(self._goals.begin_goal, handle),
                on_progress=partial(self._feedback, handle),
            )
        except ImError as error:
            result.success, result.status = False, to_status(error)
            fail(handle, error)
        else:
            result.success, result.status = True, ok_status()
            result.duration, result.force = float(results["duration"]), float(results.get("force", 0.0))
            handle.succeed()
        finally:
            self._goals.end_goal(handle)
        self._add_state(group, result)
        return result

    def _arguments(self, group: str, goal: Move.Goal) -> dict[str, Any]:
        """Return the arguments of the request; too large or infinite values are refused before the servo."""
        self._mcs.check(goal)
        if goal.policy not in _POLICIES:
            raise DataError(f"policy {goal.policy} is not one of 0 (refuse), 1 (append), 2 (replace)")
        if goal.line and goal.path.points:
            raise DataError("a move has a path or a line, not both")
        if goal.arc and not goal.line:
            raise DataError("arc is for a line, and this move has none")
        lead = self._lead(group, goal)
        path: dict[str, Any] = {"kind": "line" if goal.line or goal.relative or lead else "joint", "blend": goal.blend}
        if goal.line:
            path |= {"poses": _poses("line", goal.line), "arc": goal.arc}
        elif path["kind"] == "joint" or goal.path.points:
            positions = [list(point.positions) for point in goal.path.points]
            joints = lead or self._mcs.group(group).joints
            path["points"] = ordered_points(group, joints, list(goal.path.joint_names), positions)
        if goal.relative:
            path["relative"] = _poses("relative", goal.relative)
        if path["kind"] == "line" and not lead:
            path["speed"] = goal.line_speed
        elif goal.line_speed != 0.0:
            raise DataError(f"line_speed {goal.line_speed:g} m/s is for a line, and this move has none")
        policy = _POLICIES[goal.policy]
        scale, force = goal.speed_scale, goal.until_force
        return {"group": group, "path": path, "policy": policy, "speed_scale": scale, "until_force": force}

    def _lead(self, group: str, goal: Move.Goal) -> list[str]:
        """Return the joints below the first wrist of a pair, if a path is given for these joints alone."""
        lead = self._mcs.lead_joints(group) if goal.path.points else []
        return lead if goal.relative or set(goal.path.joint_names) == set(lead) else []

    def _add_state(self, group: str, result: Move.Result) -> None:
        mcs = self._mcs
        try:
            description = mcs.group(group)
            snapshot = mcs.client().snapshot()
        except ImError:
            return  # unconfigured, or not a group of the preset: the result's status says so
        state = group_state(group, description, mcs.model, snapshot, mcs.config.servo.period_s)
        result.state = messages.group_state(state)

    def _feedback(self, handle: ServerGoalHandle, progress: MotionProgress) -> None:
        message = Move.Feedback(progress=progress.share, point=progress.point)
        message.stamp = to_stamp(int(self._mcs.client().snapshot()["stamp_ns"]))
        handle.publish_feedback(message)


def _poses(field: str, poses: Sequence[Pose]) -> list[list[float]]:
    return [_pose(field, number, pose) for number, pose in enumerate(poses, start=1)]


def _pose(field: str, number: int, pose: Pose) -> list[float]:
    p, o = pose.position, pose.orientation
    position, orientation = [p.x, p.y, p.z], [o.x, o.y, o.z, o.w]
    try:
        wrist_pose(position, orientation)
    except DataError as error:
        name = f"pose {number} of the line" if field == "line" else f"relative pose {number}"
        raise DataError(f"{name}: {error.message}", pose=number) from None
    return position + orientation
