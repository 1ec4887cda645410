"""A toy for ``fetch.yaml``: an arm of three joints and a gripper, two action servers of the standard types.

``scripts/shell.sh python docs/nets/your_robot/toy_robot.py`` plays them until Ctrl-C, with nothing but rclpy.
"""

import time

import rclpy
from control_msgs.action import FollowJointTrajectory, GripperCommand
from rclpy.action import ActionServer, CancelResponse
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node

JOINTS = ["shoulder", "elbow", "wrist"]
#: Width of the part between the jaws [m], and speed of the jaws [m/s].
PART_M = 0.02
SPEED_M_S = 0.05
PERIOD_S = 0.02


class ToyRobot(Node):
    """Plays an arm and a gripper: each goal takes its time, and the jaws stop at the part."""

    def __init__(self) -> None:
        super().__init__("toy_robot")
        self._width = 0.0
        accept = {"cancel_callback": lambda _: CancelResponse.ACCEPT}
        arm, gripper = "/arm_controller/follow_joint_trajectory", "/gripper_controller/gripper_cmd"
        self._arm = ActionServer(self, FollowJointTrajectory, arm, self._follow, **accept)
        self._gripper = ActionServer(self, GripperCommand, gripper, self._grip, **accept)
        self._tell(f"offers {arm} and {gripper}; Ctrl-C ends it")

    def _follow(self, goal):
        """Reach each point of a trajectory when it is due."""
        result, trajectory = FollowJointTrajectory.Result(), goal.request.trajectory
        if sorted(trajectory.joint_names) != sorted(JOINTS):
            result.error_code, result.error_string = result.INVALID_JOINTS, f"the joints are {', '.join(JOINTS)}"
            goal.abort()
            return result
        began = time.monotonic()
        for point in trajectory.points:
            while time.monotonic() < began + point.time_from_start.sec + point.time_from_start.nanosec * 1e-9:
                if goal.is_cancel_requested:
                    goal.canceled()
                    return result
                time.sleep(PERIOD_S)
            self._tell(f"arm at {list(point.positions)} rad")
        goal.succeed()
        return result

    def _grip(self, goal):
        """Move the jaws to a width, or until they hold the part."""
        wanted, step = goal.request.command.position, SPEED_M_S * PERIOD_S
        target = max(wanted, PART_M) if self._width >= PART_M else wanted
        while self._width != target and not goal.is_cancel_requested:
            time.sleep(PERIOD_S)
            self._width += max(-step, min(step, target - self._width))
        result = GripperCommand.Result(position=self._width)
        if self._width != target:
            goal.canceled()
            return result
        result.stalled, result.reached_goal = target != wanted, target == wanted
        self._tell(f"gripper at {self._width:.3f} m" + (", holds the part" if result.stalled else ""))
        goal.succeed()
        return result

    def _tell(self, text: str) -> None:
        print(f"toy_robot: {text}", flush=True)


def main() -> None:
    """Play the robot until it is ended."""
    rclpy.init()
    executor = MultiThreadedExecutor()
    executor.add_node(ToyRobot())
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        return


if __name__ == "__main__":
    main()
