"""Process of :class:`im_mcs.testbed.trajectory.TrajectoryDriver`: as :mod:`im_mcs.ros.topic_channels`, with goals."""

import json
import math
import sys
from functools import partial
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from control_msgs.action import FollowJointTrajectory
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectoryPoint

from im_core.ros import run as ros_run
from im_core.ros.guard import GuardedActionClient
from im_mcs.ros.topic_channels import TopicChannels
from im_mcs.testbed.joint_state import SpeedTopic
from im_mcs.testbed.trajectory import TrajectoryDriver

_LOOK_S = 0.2
_GOAL = "goal"
_ENDS = {
    FollowJointTrajectory.Result.SUCCESSFUL: "another client's goal, or a cancel, ended it",
    FollowJointTrajectory.Result.INVALID_GOAL: "it is no goal that the robot can follow",
    FollowJointTrajectory.Result.INVALID_JOINTS: "its joints are not those of the controller",
    FollowJointTrajectory.Result.OLD_HEADER_TIMESTAMP: "it began in the past: clocks differ, or delay_s is short",
    FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED: "the robot left the path by more than it tolerates",
    FollowJointTrajectory.Result.GOAL_TOLERANCE_VIOLATED: "the robot missed the end by more than it tolerates",
}


class TrajectoryChannels(TopicChannels):
    """Joint states into shared memory, courses out of shared memory, as goals.

    Args:
        delay_s: Time between a course and the begin of its goal [s]; 0: the goal begins when it arrives.
        speed: Fields of the :class:`~im_mcs.testbed.joint_state.SpeedTopic`, if there is one.
        **settings: As of :class:`~im_mcs.ros.topic_channels.TopicChannels`; ``command`` is the name of the action.
    """

    points = TrajectoryDriver.points

    def __init__(self, delay_s: float, speed: dict[str, Any] | None = None, **settings: Any) -> None:
        self._scaling = None if speed is None else SpeedTopic.model_validate(speed)
        self._delay_s, self._goal, self._moves = delay_s, 0, False
        super().__init__(**settings)

    def _open(self, command: str) -> None:
        self._action = command
        self._number = int(self._link.course.read()["number"])  # of a course from before nothing is sent
        self._client = GuardedActionClient(self, FollowJointTrajectory, command)
        self._canceller = self.create_client(CancelGoal, f"{command}/_action/cancel_goal")
        self._orphaned = float(self._link.command.read()["at"]) > 0.0  # goals of a process before this one go on
        if (scaling := self._scaling) is not None:
            self._note_fault(scaling.topic, f"nothing was heard of {scaling.topic}")
            message_type = self._class_of(scaling.topic, scaling.type, scaling.field)
            self._listen(message_type, scaling.topic, partial(self._take_speed, scaling))
        self._count_servers()
        self.create_timer(_LOOK_S, self._count_servers)

    def _take_speed(self, scaling: SpeedTopic, message: Any) -> None:
        self._note_fault(scaling.topic, "")
        speed = float(getattr(message, scaling.field)) / scaling.full
        with self._lock:
            self._received["speed"] = min(max(speed, 0.0), 1.0) if math.isfinite(speed) else 0.0
            self._link.received.write(self._received)

    def _count_servers(self) -> None:
        if self._orphaned and self._canceller.service_is_ready():
            self._orphaned = False
            self._cancel()
        count = self.count_publishers(f"{self._action}/_action/status")
        told = {0: f"there is no server of {self._action}", 1: ""}
        self._note_fault("servers", told.get(count, f"there are {count} servers of {self._action}; 1 is needed"))

    def _publish(self, value: NDArray[np.float64], driven: NDArray[np.bool_]) -> None:
        """Send a new course of driven joints; cancel where none is driven any more."""
        if driven.any():
            self._moves = True
            course = self._link.course.read()
            if int(course["number"]) != self._number:
                self._number = int(course["number"])
                self._send(course)
        elif self._moves:
            self._moves = False
            self._goal += 1
            self._cancel()
            self._note_fault(_GOAL, "")

    def _cancel(self) -> None:
        """Cancel all goals of the action: no time and no id stand for all of them."""
        self._canceller.call_async(CancelGoal.Request())

    def _send(self, course: NDArray[np.void]) -> None:
        goal, count = FollowJointTrajectory.Goal(), int(course["count"])
        goal.trajectory.joint_names = self._joints
        if self._delay_s > 0.0:
            begin = self.get_clock().now() + Duration(nanoseconds=round(1e9 * self._delay_s))
            goal.trajectory.header.stamp = begin.to_msg()
        goal.trajectory.points = [
            JointTrajectoryPoint(
                positions=q, velocities=v, time_from_start=Duration(nanoseconds=round(1e9 * seconds)).to_msg()
            )
            for seconds, q, v in zip(*(course[name][:count].tolist() for name in ("seconds", "q", "v")), strict=True)
        ]
        self._goal += 1
        self._client.send_goal_async(goal).add_done_callback(partial(self._take_answer, self._goal))

    def _take_answer(self, number: int, answer: Future) -> None:
        handle = answer.result()
        if handle is None or not handle.accepted:
            if number == self._goal:
                self._note_fault(_GOAL, f"{self._action} refused the trajectory")
        elif number != self._goal and not self._moves:
            self._cancel()  # the joints were released before the answer came
        else:
            handle.get_result_async().add_done_callback(partial(self._take_end, number))

    def _take_end(self, number: int, end: Future) -> None:
        told = end.result()
        if number != self._goal or told is None:
            return  # a newer goal has taken over
        code = told.result.error_code
        if told.status != GoalStatus.STATUS_SUCCEEDED or code != FollowJointTrajectory.Result.SUCCESSFUL:
            words = _ENDS.get(code, f"code {code}")
            said = f" ({told.result.error_string})" if told.result.error_string else ""
            self._note_fault(_GOAL, f"{self._action} ended the trajectory: {words}{said}")


def main(arguments: list[str]) -> int:
    """Run until SIGTERM, or until the driver is gone."""
    settings: dict[str, Any] = json.loads(arguments[0])
    return ros_run.main(lambda: TrajectoryChannels(**settings), [], TrajectoryChannels.stop)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
