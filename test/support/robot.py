"""A stranger's robot: two action servers of the standard types, written with nothing of this workspace.

``python robot.py FOLDER`` writes a line to ``FOLDER/done`` for each goal that it has carried out. While there is a file
``FOLDER/hold``, the gripper does not come to the position that it names; it tells so in ``FOLDER/held``. While there is
a file ``FOLDER/pressed``, it publishes that its button is pressed.
"""

import sys
import time
from pathlib import Path

import rclpy
from control_msgs.action import FollowJointTrajectory, GripperCommand
from rclpy.action import ActionServer, CancelResponse
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Empty

MOVE_S = 0.1


class Robot(Node):
    """An arm and a gripper."""

    def __init__(self, folder: Path) -> None:
        super().__init__("robot")
        self._folder = folder
        arm, gripper = "/arm_controller/follow_joint_trajectory", "/gripper_controller/gripper_cmd"
        accept = {"cancel_callback": lambda _: CancelResponse.ACCEPT}
        self._arm = ActionServer(self, FollowJointTrajectory, arm, self._follow, **accept)
        self._button = self.create_publisher(Empty, "/button", 1)
        self.create_timer(0.1, self._tell_button)
        self._gripper = ActionServer(self, GripperCommand, gripper, self._grip, **accept)

    def _tell_button(self):
        if (self._folder / "pressed").exists():
            self._button.publish(Empty())

    def _follow(self, goal):
        time.sleep(MOVE_S)
        positions = [list(point.positions) for point in goal.request.trajectory.points]
        self._note("arm", positions[-1])
        goal.succeed()
        return FollowJointTrajectory.Result()

    def _grip(self, goal):
        width = goal.request.command.position
        if self._is_held(width):
            self._note("gripper", width, "held")
        while self._is_held(width):
            if goal.is_cancel_requested:
                goal.canceled()
                return GripperCommand.Result()
            time.sleep(0.02)
        self._note("gripper", width)
        goal.succeed()
        return GripperCommand.Result(position=width, reached_goal=True)

    def _is_held(self, width: float) -> bool:
        try:
            return float((self._folder / "hold").read_text()) == width
        except FileNotFoundError:
            return False

    def _note(self, what: str, value: object, file: str = "done") -> None:
        with (self._folder / file).open("a") as lines:
            lines.write(f"{what} {value}\n")


def main() -> None:
    """Runs the robot until it is ended."""
    rclpy.init()
    executor = MultiThreadedExecutor()
    executor.add_node(Robot(Path(sys.argv[1])))
    print("ready", flush=True)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        return


if __name__ == "__main__":
    main()
