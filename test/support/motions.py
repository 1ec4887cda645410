"""Goals, lines and places that tests of motions share."""

import threading

import numpy as np
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_msgs.srv import ForwardKinematics


def position(pose):
    return np.array([pose.position.x, pose.position.y, pose.position.z])


def below(client, depth):
    """The wrist's pose, ``depth`` [m] lower."""
    pose = client.group_state().wrist
    pose.position.z -= depth
    return pose


def forward(client, q):
    answer = client.call(ForwardKinematics, "forward_kinematics", group=client.group, q=list(map(float, q)))
    assert answer.success, answer.status.message
    return answer.wrist


def duration(seconds):
    return Duration(sec=int(seconds), nanosec=round(1e9 * (seconds - int(seconds))))


def stamp(seconds):
    return Time(sec=int(seconds), nanosec=round(1e9 * (seconds - int(seconds))))


def trajectory(client, *points, joints=(), start=0.0):
    """A trajectory through (time, positions), at rest in the last point."""
    message = JointTrajectory(joint_names=list(joints or client.joints))
    message.header.stamp = stamp(start)
    for time, q in points:
        message.points.append(JointTrajectoryPoint(positions=list(map(float, q)), time_from_start=duration(time)))
    return message


def goal(client, *points, **options):
    return FollowJointTrajectory.Goal(trajectory=trajectory(client, *points, **options))


def now(client):
    time = client.group_state().stamp
    return time.sec + 1e-9 * time.nanosec


def far(client, time=8.0):
    """A goal of some seconds, a metre or radian of the first joint."""
    return goal(client, (time, client.home + np.eye(len(client.home))[0]))


def started(client, request):
    """A goal that is under way."""
    moving = threading.Event()
    handle, result = client.follow(request, lambda _: moving.set())
    assert moving.wait(60.0)
    return handle, result


def dead(testbed):
    """Whether there is no power and every brake holds."""
    state = testbed.read_state()
    return state.brakes.all() and not state.power
