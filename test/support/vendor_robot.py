"""A robot as its vendor's driver shows it: ``python -m support.vendor_robot --joints a,b --home 0.1,0.2``.

It speaks topics and services alone, on a clock of its own, 125 times a second: ``/joint_states`` of all joints in its
own order, and a topic of commands as a ``forward_command_controller`` of ros2_control has it. Each joint is a position
servo, a first-order lag with a largest speed; the last command stays in force. ``/vendor/safety`` says whether it stands
in a protective stop, which ``/vendor/protective_stop`` begins and ends; commands of that time are forgotten.
"""

import argparse
import sys

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool

from im_core import clock
from im_core.ros import qos, run
from im_core.ros.guard import GuardedNode

PERIOD_S = 0.008
LAG_S = 0.04

UR5E = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR5E_HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)


class VendorRobot(GuardedNode):
    """Joints that follow positions or velocities.

    Args:
        joints: Names, in the order of the controller.
        home: Where they are at first, shape (n,) [rad or m].
        kind: ``position`` or ``velocity``.
        speed: Largest speed of each joint [rad/s or m/s].
        lost: Share of messages that are lost, either way.
    """

    def __init__(self, joints: list[str], home: list[float], kind: str, speed: float, lost: float) -> None:
        super().__init__("vendor_robot")
        self.joints, self.kind, self.speed, self.lost = joints, kind, speed, lost
        self.q = np.array(home)
        self.target, self.velocity = self.q.copy(), np.zeros(len(joints))
        self.stopped = False
        self.random, self.last = np.random.default_rng(1), clock.monotonic()
        self.states = self.create_publisher(JointState, "/joint_states_of_vendor", 10)
        self.safety = self.create_publisher(Bool, "/vendor/safety", qos.LATCHED)
        self.safety.publish(Bool(data=False))
        self.create_subscription(Float64MultiArray, f"/forward_{kind}_controller/commands", self.obey, 10)
        self.create_service(SetBool, "/vendor/protective_stop", self.protective_stop)
        self.create_timer(PERIOD_S, self.step)

    def obey(self, message: Float64MultiArray) -> None:
        """Take a command of the right size; others are ignored without a word."""
        if len(message.data) != len(self.joints) or self.stopped or self.random.random() < self.lost:
            return
        if self.kind == "position":
            self.target = np.array(message.data)
        else:
            self.velocity = np.array(message.data)

    def protective_stop(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Begin or end a protective stop."""
        self.stopped = request.data
        self.target, self.velocity = self.q.copy(), np.zeros(len(self.joints))
        self.safety.publish(Bool(data=self.stopped))
        response.success = True
        return response

    def step(self) -> None:
        """Move for the time that has passed, and tell where the joints are."""
        now = clock.monotonic()
        dt, self.last = now - self.last, now
        if self.kind == "position":
            way = (self.target - self.q) * -np.expm1(-dt / LAG_S)
        else:
            way = self.velocity * dt
        if not self.stopped:
            self.q = self.q + np.clip(way, -self.speed * dt, self.speed * dt)
        if self.random.random() >= self.lost:
            message = JointState(name=self.joints[::-1], position=self.q[::-1].tolist())
            message.header.stamp = self.get_clock().now().to_msg()
            self.states.publish(message)


def main() -> int:
    """Run until SIGTERM."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--joints", default=",".join(UR5E))
    parser.add_argument("--home", default=",".join(map(str, UR5E_HOME)))
    parser.add_argument("--kind", default="position", choices=("position", "velocity"))
    parser.add_argument("--speed", type=float, default=3.0)
    parser.add_argument("--lost", type=float, default=0.0)
    given = parser.parse_args()
    home = [float(value) for value in given.home.split(",")]
    return run.main(lambda: VendorRobot(given.joints.split(","), home, given.kind, given.speed, given.lost), [])


if __name__ == "__main__":
    sys.exit(main())
