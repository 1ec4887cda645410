"""A robot as its vendor's driver shows it: ``python -m support.vendor_robot --joints a,b --home 0.1,0.2``.

It speaks topics, services and an action alone, on a clock of its own, 125 times a second: joint states of all joints in
its own order, and a topic of commands as a ``forward_command_controller`` of ros2_control has it, or an action as a
``joint_trajectory_controller``. Each joint is a position servo, a first-order lag with a largest speed; the last
command stays in force. ``/vendor/safety`` says whether it stands in a protective stop, which
``/vendor/protective_stop`` begins and ends; commands of that time are forgotten. ``/vendor/block`` holds the joints,
``/vendor/refuse`` lets it take no goal, and ``/vendor/run_away`` turns its last joint faster than any command. With
``--stall`` it holds its joint states back for that part of each second, then tells them at once. A trajectory's clock
goes at the share of ``/vendor/slider``, told in percent on ``/vendor/speed_scaling``.
"""

import argparse
import sys
from dataclasses import dataclass
from functools import partial

import numpy as np
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import SetBool

from im_core import clock
from im_core.ros import qos, run
from im_core.ros.guard import GuardedNode

PERIOD_S = 0.008
LAG_S = 0.04
RUN_AWAY = 2.0

UR5E = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR5E_HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)


@dataclass
class Active:
    """Goal under way: its handle, what ends it, its begin on the robot's clock [s], and its points."""

    handle: ServerGoalHandle
    end: Future
    begin: float
    times: np.ndarray
    q: np.ndarray
    v: np.ndarray

    def at(self, now):
        """Positions and velocities at a time, of the cubic through the points around it."""
        t = min(now - self.begin, self.times[-1])
        k = int(np.clip(np.searchsorted(self.times, t, side="right"), 1, len(self.times) - 1))
        h = self.times[k] - self.times[k - 1]
        s = (t - self.times[k - 1]) / h
        way, begin, end = self.q[k] - self.q[k - 1], h * self.v[k - 1], h * self.v[k]
        square, cube = 3 * way - 2 * begin - end, begin + end - 2 * way
        return self.q[k - 1] + s * (begin + s * (square + s * cube)), (begin + s * (2 * square + s * 3 * cube)) / h


class VendorRobot(GuardedNode):
    """Joints that follow positions, velocities or trajectories.

    Args:
        joints: Names, in the order of the controller.
        home: Where they are at first, shape (n,) [rad or m].
        kind: ``position``, ``velocity`` or ``trajectory``.
        speed: Largest speed of each joint [rad/s or m/s].
        lost: Share of messages that are lost, either way.
        tolerance: Largest error on the way of a trajectory, and in the end half a second later [rad or m].
        stall: Of each second, for how long joint states are held back [s].
    """

    def __init__(self, joints, home, kind, speed, lost, tolerance, stall) -> None:
        super().__init__("vendor_robot")
        self.joints, self.kind, self.speed, self.lost = joints, kind, speed, lost
        self.stall, self.held = stall, []
        self.q = np.array(home)
        self.target, self.velocity = self.q.copy(), np.zeros(len(joints))
        self.speeds = self.create_publisher(Float64, "/vendor/speed_scaling", qos.LATCHED)
        self.create_subscription(Float64, "/vendor/slider", self.slide, qos.LATCHED)
        self.slide(Float64(data=1.0))
        self.stopped = self.blocked = self.refusing = self.running_away = False
        self.tolerance, self.active = tolerance, None
        self.random, self.last = np.random.default_rng(1), clock.monotonic()
        self.states = self.create_publisher(JointState, "/joint_states_of_vendor", 10)
        self.safety = self.create_publisher(Bool, "/vendor/safety", qos.LATCHED)
        self.safety.publish(Bool(data=False))
        if kind == "trajectory":
            self.server = ActionServer(
                self,
                FollowJointTrajectory,
                "/vendor_controller/follow_joint_trajectory",
                self.execute,
                goal_callback=self.judge,
                handle_accepted_callback=self.begin,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
            )
        else:
            self.create_subscription(Float64MultiArray, f"/forward_{kind}_controller/commands", self.obey, 10)
        self.create_service(SetBool, "/vendor/protective_stop", self.protective_stop)
        self.create_service(SetBool, "/vendor/block", partial(self.switch, "blocked"))
        self.create_service(SetBool, "/vendor/refuse", partial(self.switch, "refusing"))
        self.create_service(SetBool, "/vendor/run_away", partial(self.switch, "running_away"))
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
        self.finish("aborted", -4, "protective stop")
        self.target, self.velocity = self.q.copy(), np.zeros(len(self.joints))
        self.safety.publish(Bool(data=self.stopped))
        response.success = True
        return response

    def slide(self, message: Float64) -> None:
        """Let trajectories go slower."""
        self.scaling = message.data
        self.speeds.publish(Float64(data=100.0 * self.scaling))

    def switch(self, name, request, response):
        """Block the joints, refuse goals, or run away."""
        setattr(self, name, request.data)
        response.success = True
        return response

    def judge(self, goal) -> GoalResponse:
        """Refuse a trajectory as a ``joint_trajectory_controller`` does."""
        trajectory = goal.trajectory
        points = trajectory.points
        times = [seconds(point.time_from_start) for point in points]
        good = not (self.stopped or self.refusing) and sorted(trajectory.joint_names) == sorted(self.joints)
        good = good and bool(points) and (np.diff(times) > 0.0).all() and not any(points[-1].velocities)
        stamp = seconds(trajectory.header.stamp)
        late = good and stamp > 0.0 and stamp + times[-1] < clock.wall()
        return GoalResponse.ACCEPT if good and not late else GoalResponse.REJECT

    def begin(self, handle: ServerGoalHandle) -> None:
        """Let a goal take over from where the joints are wanted now."""
        self.finish("aborted", -1, "Current goal cancelled due to new incoming action.")
        trajectory, now = handle.request.trajectory, clock.monotonic()
        order = [list(trajectory.joint_names).index(joint) for joint in self.joints]
        stamp = trajectory.header.stamp
        wait = 1e-9 * (Time.from_msg(stamp, self.get_clock().clock_type) - self.get_clock().now()).nanoseconds
        begin = now + wait if seconds(stamp) > 0.0 else now
        times = [now - begin, *(seconds(point.time_from_start) for point in trajectory.points)]
        q = [self.target, *(np.array(point.positions)[order] for point in trajectory.points)]
        v = [self.velocity, *(np.array(point.velocities)[order] for point in trajectory.points)]
        later = [0, *(k for k in range(1, len(times)) if times[k] > times[0])]
        points = (np.array([row[k] for k in later]) for row in (times, q, v))
        self.active = Active(handle, Future(), begin, *points)
        handle.execute()

    async def execute(self, handle: ServerGoalHandle) -> FollowJointTrajectory.Result:
        """Wait for the end of a goal."""
        how, code, told = await self.active.end
        {"succeeded": handle.succeed, "canceled": handle.canceled, "aborted": handle.abort}[how]()
        return FollowJointTrajectory.Result(error_code=code, error_string=told)

    def finish(self, how: str, code: int = 0, told: str = "") -> None:
        """End the goal under way; the joints hold what they were told last, or where they are after a failure."""
        if self.active is not None:
            self.active.end.set_result((how, code, told))
            self.active, self.velocity = None, np.zeros(len(self.joints))
            if how != "succeeded" and code != -1:
                self.target = self.q.copy()

    def follow(self, now: float) -> None:
        """Take the target of a goal under way, and judge it."""
        active = self.active
        if active.handle.is_cancel_requested:
            self.finish("canceled")
            return
        self.target, velocity = active.at(now)
        self.velocity = velocity * self.scaling
        error, over = np.abs(self.target - self.q).max(), now - active.begin - active.times[-1]
        if over < 0.0 and error > self.tolerance:
            self.finish("aborted", -4, "Aborted due to path tolerance violation")
        elif over >= 0.0 and error < 1e-3:
            self.finish("succeeded")
        elif over > 0.5 and error > self.tolerance:
            self.finish("aborted", -5, "Aborted due to goal_time_tolerance exceeding")

    def step(self) -> None:
        """Move for the time that has passed, and tell where the joints are."""
        now, stamp = clock.monotonic(), self.get_clock().now().to_msg()
        dt, self.last = now - self.last, now
        if self.active is not None:
            self.active.begin += dt * (1.0 - self.scaling)
            self.follow(now)
        lagging = (self.target - self.q) * -np.expm1(-dt / LAG_S)
        way = self.velocity * dt if self.kind == "velocity" else lagging
        if not (self.stopped or self.blocked):
            self.q = self.q + np.clip(way, -self.speed * dt, self.speed * dt)
        if self.running_away:
            self.q[-1] += RUN_AWAY * dt
        if self.random.random() >= self.lost:
            message = JointState(name=self.joints[::-1], position=self.q[::-1].tolist())
            message.header.stamp = stamp
            self.held.append(message)
        if now % 1.0 >= self.stall:
            for message in self.held:
                self.states.publish(message)
            self.held = []


def seconds(stamp) -> float:
    """A time or a duration of a message [s]."""
    return stamp.sec + 1e-9 * stamp.nanosec


def main() -> int:
    """Run until SIGTERM."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--joints", default=",".join(UR5E))
    parser.add_argument("--home", default=",".join(map(str, UR5E_HOME)))
    parser.add_argument("--kind", default="position", choices=("position", "velocity", "trajectory"))
    parser.add_argument("--speed", type=float, default=3.0)
    parser.add_argument("--lost", type=float, default=0.0)
    parser.add_argument("--tolerance", type=float, default=0.3)
    parser.add_argument("--stall", type=float, default=0.0)
    given = parser.parse_args()
    home = [float(value) for value in given.home.split(",")]
    joints, options = given.joints.split(","), (given.kind, given.speed, given.lost, given.tolerance, given.stall)
    return run.main(lambda: VendorRobot(joints, home, *options), [])


if __name__ == "__main__":
    sys.exit(main())
