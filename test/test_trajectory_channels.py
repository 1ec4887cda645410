"""The process that sends courses as goals: what the robot is asked for, and what MCS is told of the ends."""

import os

import numpy as np
import pytest
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future

from im_core import clock
from im_core.ros.guard import GuardedNode
from im_mcs.ros.trajectory_channels import TrajectoryChannels
from im_mcs.testbed.joint_state import TopicLink

NAME = f"imgoals{os.getpid()}"
ACTION = "/vendor/follow_joint_trajectory"
Result = FollowJointTrajectory.Result


class Vendor:
    """Both ends of the process: the driver's memory, and the vendor's action.

    Attributes:
        goals: Each goal that came.
        ends: What lets a goal end: ``(how, code, text)``.
        cancelled: How many goals were asked to be cancelled.
    """

    def __init__(self, ros, delay_s=0.0, served=True):
        self.link, self.node = TopicLink.create(NAME, TopicLink.layout(2, TrajectoryChannels.points)), GuardedNode("r")
        self.goals, self.ends, self.cancelled, self.accepts = [], [], 0, True
        settings = {"name": NAME, "joints": ["x", "y"], "kinds": ["position"] * 2, "state": "/vendor/state"}
        self.channels = TrajectoryChannels(delay_s, command=ACTION, silence_s=60.0, **settings)
        self.number, self.servers = 0, []
        if served:
            self.serve()
        ros(self.channels, self.node)

    def serve(self):
        self.servers.append(
            ActionServer(
                self.node,
                FollowJointTrajectory,
                ACTION,
                self.execute,
                goal_callback=self.judge,
                cancel_callback=self.cancel,
            )
        )

    def judge(self, goal):
        return GoalResponse.ACCEPT if self.accepts else GoalResponse.REJECT

    def cancel(self, handle):
        self.cancelled += 1
        return CancelResponse.ACCEPT

    async def execute(self, handle):
        self.goals.append(handle.request.trajectory)
        self.ends.append(Future())
        how, code, text = await self.ends[-1]
        {"succeeded": handle.succeed, "aborted": handle.abort}[how]()
        return Result(error_code=code, error_string=text)

    def drive(self, driven=(True, True)):
        command = self.link.command.record()
        command["driven"], command["at"] = driven, clock.monotonic()
        self.link.command.write(command)
        self.link.bell.post()

    def course(self, *q):
        """A course of points, a second apart."""
        self.number += 1
        record, count = self.link.course.record(), len(q)
        record["number"], record["count"], record["seconds"][:count] = self.number, count, np.arange(1.0, count + 1.0)
        record["q"][:count] = np.array(q)
        self.link.course.write(record)

    def faults(self):
        return bytes(self.link.received.read()["faults"]).rstrip(b"\0").decode()


@pytest.fixture
def vendor(ros):
    made = []

    def make(**options):
        made.append(Vendor(ros, **options))
        return made[-1]

    yield make
    for each in made:
        for end in each.ends:
            if not end.done():
                end.set_result(("aborted", 0, ""))
        each.channels.stop()
        each.link.close()


def test_a_course_is_a_goal_and_the_next_one_takes_over(vendor, wait_until):
    vendor = vendor(delay_s=2.0)
    wait_until(lambda: vendor.faults() == "", "the server")
    began = clock.wall()
    vendor.course([0.1, 0.2], [0.3, 0.4])
    wait_until(lambda: vendor.drive() or vendor.goals, "a goal")
    (goal,) = vendor.goals
    assert goal.joint_names == ["x", "y"]
    assert [list(point.positions) for point in goal.points] == [[0.1, 0.2], [0.3, 0.4]]
    assert [point.time_from_start.sec for point in goal.points] == [1, 2]
    stamp = goal.header.stamp.sec + 1e-9 * goal.header.stamp.nanosec
    assert began + 1.9 < stamp < clock.wall() + 2.1
    vendor.course([0.5, 0.6])
    wait_until(lambda: vendor.drive() or len(vendor.goals) == 2, "the next goal")
    vendor.ends[0].set_result(("aborted", Result.INVALID_GOAL, "a new goal came"))
    vendor.ends[1].set_result(("succeeded", Result.SUCCESSFUL, ""))
    for _ in range(20):
        vendor.drive()
        clock.sleep(0.02)
    assert len(vendor.goals) == 2, "a course is sent once"
    assert vendor.faults() == ""


def test_joints_that_are_released_cancel_and_nothing_is_sent_for_them(vendor, wait_until):
    vendor = vendor()
    wait_until(lambda: vendor.faults() == "", "the server")
    vendor.course([0.1, 0.2])
    wait_until(lambda: vendor.drive() or vendor.goals, "a goal")
    assert vendor.goals[0].header.stamp.sec == 0
    wait_until(lambda: vendor.drive((False, False)) or vendor.cancelled, "the cancel")
    vendor.ends[0].set_result(("aborted", 0, ""))
    vendor.course([0.3, 0.4])
    for _ in range(20):
        vendor.drive((False, False))
        clock.sleep(0.02)
    assert len(vendor.goals) == 1
    assert vendor.faults() == ""


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (Result.SUCCESSFUL, "another client's goal, or a cancel, ended it"),
        (Result.INVALID_GOAL, "it is no goal that the robot can follow"),
        (Result.INVALID_JOINTS, "its joints are not those of the controller"),
        (Result.OLD_HEADER_TIMESTAMP, "it began in the past: clocks differ, or delay_s is short"),
        (Result.PATH_TOLERANCE_VIOLATED, "the robot left the path by more than it tolerates"),
        (Result.GOAL_TOLERANCE_VIOLATED, "the robot missed the end by more than it tolerates"),
        (-77, "code -77"),
    ],
)
def test_an_end_before_the_end_is_a_fault_in_words_until_the_joints_are_released(vendor, wait_until, code, words):
    vendor = vendor()
    wait_until(lambda: vendor.faults() == "", "the server")
    vendor.course([0.1, 0.2])
    wait_until(lambda: vendor.drive() or vendor.goals, "a goal")
    vendor.ends[0].set_result(("aborted", code, "says it"))
    wait_until(lambda: vendor.drive() or vendor.faults(), "the fault")
    assert vendor.faults() == f"{ACTION} ended the trajectory: {words} (says it)"
    wait_until(lambda: vendor.drive((False, False)) or vendor.faults() == "", "no fault")


def test_a_refused_goal_and_a_wrong_number_of_servers_are_faults(vendor, wait_until):
    vendor = vendor(served=False)
    assert vendor.faults() == f"there is no server of {ACTION}"
    vendor.serve()
    wait_until(lambda: vendor.faults() == "", "the server")
    vendor.accepts = False
    vendor.course([0.1, 0.2])
    wait_until(lambda: vendor.drive() or vendor.faults(), "the refusal")
    assert vendor.faults() == f"{ACTION} refused the trajectory"
    wait_until(lambda: vendor.drive((False, False)) or vendor.faults() == "", "no fault")
    vendor.serve()
    wait_until(lambda: vendor.faults() == f"there are 2 servers of {ACTION}; 1 is needed", "two servers")
