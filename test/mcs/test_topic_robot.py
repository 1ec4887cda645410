"""Node ``/mcs`` without the simulated testbed: a robot that speaks topics takes its place, in real time."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import yaml
from control_msgs.action import FollowJointTrajectory
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

from im_core import clock, names
from im_core.processes.procfs import stat_fields
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_mcs.testbed.joint_state import TopicLink
from im_msgs.srv import ReserveGroup
from support.mcs_config import mcs_text

DRIVER = "im_mcs.testbed.joint_state:JointStateDriver"

#: Every joint a mass of its own that gravity pulls, unless it is told where to be or how fast to move. Its time passes
#: with the commands, a tick each, so that the loop is as good on a busy computer; a joint that a command leaves out is
#: held.
ROBOT = """
    import sys
    import numpy as np
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from im_cell.robot import load_cell
    from im_core.ros import qos, run
    from im_mcs.model import CellModel

    PERIOD_S = float(sys.argv.pop())

    class Robot(Node):
        def __init__(self):
            super().__init__("robot")
            cell = load_cell()
            self.model, self.names = CellModel(cell), list(cell.joint_names)
            self.q, self.v = cell.home.copy(), np.zeros(18)
            self.inertia = self.model.inertia_diagonal(cell.home)
            self.publisher = self.create_publisher(JointState, "/robot/state", qos.SENSOR)
            self.create_subscription(JointState, "/robot/command", self.obey, qos.SENSOR)
            self.create_timer(0.05, self.tell)

        def obey(self, message):
            driven = [self.names.index(name) for name in message.name]
            if message.position:
                self.q[driven] = message.position
            elif message.velocity:
                self.q[driven] += np.array(message.velocity) * PERIOD_S
            else:
                self.push(driven, message.effort)
            self.tell()

        def push(self, driven, torques):
            effort, held = np.zeros(18), np.ones(18, dtype=bool)
            effort[driven], held[driven] = torques, False
            dt = 0.0045 / 4
            for _ in range(round(PERIOD_S / dt)):
                self.v += (effort - self.model.gravity(self.q)) / self.inertia * dt
                self.v[held] = 0.0
                self.q = self.q + self.v * dt

        def tell(self):
            self.publisher.publish(JointState(name=self.names, position=self.q.tolist()))

    sys.exit(run.main(Robot))
"""


@pytest.fixture
def robot(request):
    period_s = getattr(request, "param", 0.0045)
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(ROBOT), str(period_s)])
    yield process
    process.kill()
    process.wait()


@pytest.fixture
def config(tmp_path):
    """``mcs.yaml`` with another driver, a law that expects delay and no friction, and patience with a busy computer."""
    data = yaml.safe_load(mcs_text())
    data["slots"] = [slot for slot in data["slots"] if slot.get("kind", "joint") == "joint"]
    for slot in data["slots"]:
        slot["driver"] = "robot"
    settings = {
        "joints": [slot["name"] for slot in data["slots"]],
        "state_topic": "/robot/state",
        "command_topic": "/robot/command",
        "silence_s": 3.0,
    }
    data["testbed"].update(clock="robot", drivers={"robot": {"driver": DRIVER, "settings": settings}})
    data["control"]["parameters"].update(
        bandwidth_rad_s=3.0, integral_rad_s=0.4, feedforward={"gravity": 1.0, "inertia": 1.0}
    )
    data["limits"].update(following_error_rad=0.5, following_error_m=0.2)
    data["safety"].update(driver_age_s=2.0, driver_age_estop_s=4.0)
    # positions that come in bunches look like speed
    data["servo"].update(max_overruns=200, velocity_bandwidth_rad_s=10)
    data["servo"]["settle"].update(tolerance=0.005, still_tolerance=0.01, timeout_s=30.0)
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


#: What each group of the preset ``3x6`` takes, and its law; torques move the carts.
KINDS = {
    "left": ("position", {"controller": "im_mcs.control.setpoints:SetpointPosition"}),
    "right": (
        "velocity",
        {
            "controller": "im_mcs.control.setpoints:SetpointVelocity",
            "parameters": {"gain_1_s": 2.0, "rest_deadband": 1e-4},
        },
    ),
}


@pytest.mark.parametrize("robot", [0.018], indirect=True)  # three messages a tick are much for a busy computer
def test_one_robot_takes_positions_velocities_and_torques_at_once(robot, config, without_testbed):
    data = yaml.safe_load(config.read_text())
    data |= {"preset": "3x6", "presets": {"3x6": data["presets"]["3x6"]}}
    data["group_control"] = {group: law for group, (_, law) in KINDS.items()}
    for slot in data["slots"]:
        moved_by = next(group for group, given in data["presets"]["3x6"].items() if slot["name"] in given["joints"])
        slot["interface"] = KINDS.get(moved_by, ("effort",))[0]
    data["servo"]["period_s"] = data["testbed"]["drivers"]["robot"]["settings"]["period_s"] = 0.018
    config.write_text(yaml.safe_dump(data))
    client = without_testbed(config=config, use_sim_time=False)
    heard = client.listen(JointState, "/robot/command", qos.SENSOR)
    groups = data["presets"]["3x6"]
    for group in groups:
        assert client.call(ReserveGroup, "reserve", group=group).success
    for step in ("power_on", "enable_motion"):
        answer = client.trigger(step)
        assert answer.success, answer.message
    starts = {group: np.array(client.group_state(group).q) for group in groups}
    ends = {group: client.start_move(q + 0.05, group=group, speed_scale=0.1)[1] for group, q in starts.items()}
    for group, end in ends.items():
        assert (result := end()).success, result.status.message
        np.testing.assert_allclose(client.group_state(group).q, starts[group] + 0.05, atol=0.01)
    for group, given in groups.items():
        kind, others = KINDS.get(group, ("effort",))[0], {"position", "velocity", "effort"}
        told = [message for message in heard if set(message.name) <= set(given["joints"])]
        assert told
        for message in told:
            assert {field for field in others if getattr(message, field)} == {kind}

    assert client.trigger("estop").success
    clock.sleep(1.0)  # longer than joints are told to stand

    def last(kind):
        return getattr([message for message in heard if getattr(message, kind)][-1], kind)

    client.until(lambda: not any(last("velocity")))
    client.until(lambda: np.allclose(last("position"), client.group_state("left").q, rtol=0.0, atol=1e-6))


def bridge_pid():
    """Process id of the bridge; None if there is none."""
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            command = (entry / "cmdline").read_bytes()
            if b"im_mcs.ros.topic_channels" in command and names.instance().encode() + b"_topics" in command:
                return int(entry.name)
    return None


def test_a_bridge_that_was_stopped_publishes_no_effort_from_before_the_emergency_stop(robot, config, without_testbed):
    client = without_testbed(config=config, use_sim_time=False)
    client.to_motion()
    efforts = client.listen(JointState, "/robot/command", qos.SENSOR)
    client.until(lambda: efforts)
    pid = bridge_pid()
    os.kill(pid, signal.SIGSTOP)
    try:
        client.until(lambda: stat_fields(pid)[0] == "T")  # the signal may come to a thread that is just sending
        stopped = clock.wall()
        client.until(lambda: client.state() == "estopped")
        efforts.clear()
    finally:
        os.kill(pid, signal.SIGCONT)
    client.until(lambda: client.trigger("reset").success)  # the bridge works again
    stamps = [effort.header.stamp for effort in efforts]  # of one that it was just sending it is before the stop
    assert not [stamp for stamp in stamps if stamp.sec + stamp.nanosec * 1e-9 > stopped]


def test_a_bridge_that_died_is_started_again(robot, config, without_testbed, monkeypatch):
    client = without_testbed(config=config, use_sim_time=False)
    client.to_motion()
    servo = client.mcs._mcs.keeper.client()
    heard = servo._on_state

    def late(*told):  # the snapshot shows the state long before its cause is heard: never one without the other
        clock.sleep(2.0)
        heard(*told)

    monkeypatch.setattr(servo, "_on_state", late)
    os.kill(bridge_pid(), signal.SIGKILL)
    client.until(lambda: client.state() == "estopped")
    assert "the process im_mcs.ros.topic_channels of topic '/robot/state' ended" in client.states[-1].reason
    monkeypatch.undo()
    client.to_motion()
    client.trigger("estop")
    assert client.trigger("reset").success
    dead = bridge_pid()
    os.kill(dead, signal.SIGKILL)  # of a cold machine
    client.until(lambda: bridge_pid() not in (None, dead))
    client.until(lambda: client.call(ReserveGroup, "reserve", group="left").success)


def test_efforts_that_are_too_old_are_not_published(ros, process, wait_until):
    name = f"{names.instance()}_topics_old"
    link = TopicLink.create(name, TopicLink.layout(1))
    settings = {
        "name": name,
        "joints": ["x"],
        "kinds": ["effort"],
        "state": "/old/state",
        "command": "/old/command",
        "silence_s": 0.5,
    }
    process(sys.executable, "-m", "im_mcs.ros.topic_channels", json.dumps(settings))
    efforts = []
    node = ros(GuardedNode("listener"))
    node.create_subscription(JointState, "/old/command", efforts.append, qos.SENSOR)
    record = link.command.record()
    record["driven"] = True

    def give(effort, age_s):
        record["value"], record["at"] = effort, clock.monotonic() - age_s
        link.command.write(record)
        link.bell.post()
        clock.sleep(0.05)

    wait_until(lambda: efforts or give(1.0, 0.0), "an effort")
    give(2.0, 0.6)
    wait_until(lambda: efforts[-1].effort[0] == 3.0 or give(3.0, 0.0), "the last one")
    assert 2.0 not in [message.effort[0] for message in efforts]
    link.close()


def test_a_trajectory_moves_a_robot_that_speaks_topics_and_its_death_is_an_estop(robot, config, without_testbed):
    client = without_testbed(config=config, use_sim_time=False)
    client.to_motion()
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = client.joints
    target = client.home + 0.05
    goal.trajectory.points = [
        JointTrajectoryPoint(positions=target.tolist(), time_from_start=Duration(seconds=4.0).to_msg())
    ]
    goal.goal_time_tolerance = Duration(seconds=60.0).to_msg()  # of a busy computer's commands some are lost
    result = client.follow(goal)[1]().result
    assert result.error_code == result.SUCCESSFUL, result.error_string
    np.testing.assert_allclose(client.group_state().q, target, atol=0.01)

    robot.kill()
    client.until(lambda: client.state() == "estopped")
    assert "/robot/state" in client.states[-1].reason
    refused = client.trigger("reset")
    assert not refused.success
    assert "/robot/state" in refused.message
