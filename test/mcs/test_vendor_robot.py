"""Node ``/mcs`` above a robot as its vendor's driver shows it: positions or velocities to a controller, real time."""

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from im_cell.robot import load_cell
from im_core import clock, names
from im_core.ros import qos
from im_msgs.action import Move
from im_msgs.srv import GroupCommand, ReserveGroup
from support.mcs_config import mcs_text

CELL = load_cell()
LAWS = {
    "position": {"controller": "im_mcs.control.setpoints:SetpointPosition"},
    "velocity": {
        "controller": "im_mcs.control.setpoints:SetpointVelocity",
        "parameters": {"gain_1_s": 1.0, "rest_deadband": 1e-3},
    },
}
#: The controller has its joints in an order of its own.
ORDER = list(CELL.joint_names[::-1])


@pytest.fixture
def vendor(process):
    """Starts the robot; its process."""

    def start(kind="position", lost=0.0, stall=0.0):
        home = ",".join(map(str, CELL.home[::-1].tolist()))
        options = ("--joints", ",".join(ORDER), f"--home={home}", "--kind", kind, "--lost", lost, "--speed", 0.5)
        options = (*options, "--stall", stall)
        return process(sys.executable, "-m", "support.vendor_robot", *options)

    return start


@pytest.fixture
def config(tmp_path):
    """Writes ``mcs.yaml`` for the robot, with patience with a busy computer; its path."""

    def write(kind="position", following=0.5):
        data = yaml.safe_load(mcs_text())
        data["slots"] = [slot for slot in data["slots"] if slot.get("kind", "joint") == "joint"]
        interface = "velocity" if kind == "velocity" else "position"
        for slot in data["slots"]:
            slot.update(driver="robot", interface=interface)
        settings = {
            "joints": [slot["name"] for slot in data["slots"]],
            "state_topic": "/joint_states_of_vendor",
            "period_s": 0.008,
            "silence_s": 3.0,
            "faults": [{"topic": "/vendor/safety"}],
        }
        if kind == "trajectory":
            settings |= {"action": "/vendor_controller/follow_joint_trajectory", "delay_s": 0.3}
            settings |= {"speed": {"topic": "/vendor/speed_scaling"}}
            driver = {"driver": "im_mcs.testbed.trajectory:TrajectoryDriver", "settings": settings}
        else:
            settings |= {"command_topic": f"/forward_{kind}_controller/commands", "command_joints": ORDER}
            driver = {"driver": "im_mcs.testbed.joint_state:CommandTopicDriver", "settings": settings}
        data["testbed"].update(clock="robot", drivers={"robot": driver})
        data["control"] = LAWS[interface]
        data["limits"].update(following_error_rad=following, following_error_m=following, velocity=0.4)
        data["safety"].update(driver_age_s=5.0, driver_age_estop_s=6.0)
        data["servo"].update(period_s=0.008, max_overruns=200)
        data["servo"]["settle"].update(tolerance=0.005, still_tolerance=0.01, timeout_s=30.0)
        path = tmp_path / "robot.yaml"
        path.write_text(yaml.safe_dump(data), encoding="utf-8")
        return path

    return write


def to_motion(client):
    """As ``client.to_motion()``, once the robot's driver has found the robot's topics and servers.

    A server that was killed counts until its lease ends, and its successor beside it may be seen at any step: that is
    an emergency stop, and the steps are taken again.
    """

    def steps():
        if client.state() == "estopped" and not client.trigger("reset").success:
            return False
        reserved = client.call(ReserveGroup, "reserve", group="left").success
        return reserved and client.trigger("power_on").success and client.trigger("enable_motion").success

    client.until(steps)


def stands(client):
    """Where the left arm stands once it moves no more, shape (9,)."""
    last = None
    while last is None or np.abs(last - (now := np.array(client.group_state().q))).max() > 1e-4:
        last = np.array(client.group_state().q)
        clock.sleep(0.3)
    return now


@pytest.mark.parametrize("kind", ["position", "velocity", "trajectory"])
def test_moves_a_line_and_stops(vendor, config, without_testbed, kind):
    vendor(kind, lost=0.05)
    client = without_testbed(config=config(kind), use_sim_time=False)
    to_motion(client)
    told = client.listen(JointState, "/joint_states", qos.EVENTS)
    result = client.move(client.home + 0.05)
    assert result.success, result
    np.testing.assert_allclose(client.group_state().q, client.home + 0.05, atol=0.01)
    client.until(lambda: told)
    stamp = told[-1].header.stamp
    assert abs(stamp.sec + 1e-9 * stamp.nanosec - clock.wall()) < 60.0, "stamps are of real time"

    lower = client.group_state().wrist
    lower.position.z -= 0.05
    assert client.move(line=[lower], line_speed=0.1).success
    assert abs(client.group_state().wrist.position.z - lower.position.z) < 0.01

    handle, result = client.start_far_move()
    client.cancel(handle)
    assert not result().success
    stood = stands(client)
    assert client.state() == "motion"

    _, result = client.start_far_move()
    assert client.trigger("estop").success
    assert not result().success
    stood = stands(client)
    assert client.trigger("reset").success
    to_motion(client)  # the first setpoint is where the arm is
    np.testing.assert_allclose(stands(client), stood, atol=2e-3)


def test_readings_that_come_late_and_at_once_stop_nothing_and_a_joint_that_runs_away_stops(
    vendor, config, without_testbed
):
    vendor(stall=0.3)
    client = without_testbed(config=config(), use_sim_time=False)
    to_motion(client)
    for target in (client.home + 0.3, client.home, client.home + 0.3):
        result = client.move(target)
        assert result.success, result
    assert client.state() == "motion"
    assert client.call(SetBool, "/vendor/run_away", data=True).success
    client.until(lambda: client.state() == "estopped")
    assert "left_track: velocity" in client.states[-1].reason


def test_a_protective_stop_of_the_vendor_is_the_reason_and_a_person_resets(vendor, config, without_testbed):
    vendor()
    client = without_testbed(config=config(), use_sim_time=False)
    to_motion(client)
    _, result = client.start_far_move()
    assert client.call(SetBool, "/vendor/protective_stop", data=True).success
    assert not result().success
    client.until(lambda: client.state() == "estopped")
    assert "cut the power" in client.states[-1].reason
    assert "/vendor/safety data is True" in client.states[-1].reason
    stood = stands(client)
    refused = client.trigger("reset")
    assert not refused.success
    assert "/vendor/safety data is True" in refused.message
    assert client.call(SetBool, "/vendor/protective_stop", data=False).success
    np.testing.assert_allclose(stands(client), stood, atol=1e-3)
    assert client.state() == "estopped", "what has cleared moves nothing, and a person resets"
    client.until(lambda: client.trigger("reset").success)
    to_motion(client)
    np.testing.assert_allclose(stands(client), stood, atol=2e-3)
    assert client.move(client.home).success


@pytest.mark.parametrize(("kind", "reason"), [("position", "/joint_states_of_vendor"), ("trajectory", "no server of")])
def test_a_vendor_that_dies_is_an_estop_and_works_again_when_it_is_back(vendor, config, without_testbed, kind, reason):
    first = vendor(kind)
    client = without_testbed(config=config(kind, following=9.0), use_sim_time=False)  # no following error
    to_motion(client)
    _, result = client.start_far_move()
    os.kill(first.pid, signal.SIGKILL)
    assert not result().success
    client.until(lambda: client.state() == "estopped")
    assert reason in client.states[-1].reason or "/joint_states_of_vendor" in client.states[-1].reason
    # what was killed is counted until its lease ends: beside its successor that would be two servers
    client.until(lambda: client.node.count_publishers("/vendor_controller/follow_joint_trajectory/_action/status") == 0)
    vendor(kind)
    client.until(lambda: client.trigger("reset").success)
    to_motion(client)
    np.testing.assert_allclose(stands(client), client.home, atol=2e-3)  # the new one begins there
    assert client.move(client.home + 0.05).success


def follow(vendor, config, without_testbed, **options):
    vendor("trajectory", **options)
    client = without_testbed(config=config("trajectory", following=9.0), use_sim_time=False)
    to_motion(client)
    return client


def estopped(client):
    client.until(lambda: client.state() == "estopped")
    return client.states[-1].reason


def test_a_pause_and_a_replacement_are_followed(vendor, config, without_testbed):
    client = follow(vendor, config, without_testbed)
    _, result = client.start_far_move()
    assert client.call(GroupCommand, "pause", group="left").success
    stood = stands(client)
    assert client.call(GroupCommand, "resume", group="left").success
    client.until(lambda: np.abs(np.array(client.group_state().q) - stood).max() > 0.01)
    _, second = client.start_move(client.home + 0.1, policy=Move.Goal.REPLACE)
    assert not result().success
    assert second().success
    np.testing.assert_allclose(stands(client), client.home + 0.1, atol=0.01)


def test_a_trajectory_that_the_vendor_ends_is_an_estop_in_words(vendor, config, without_testbed):
    client = follow(vendor, config, without_testbed)
    _, result = client.start_far_move()
    assert client.call(SetBool, "/vendor/block", data=True).success
    assert not result().success
    reason = estopped(client)
    assert "the robot left the path by more than it tolerates (Aborted due to path tolerance violation)" in reason
    assert client.call(SetBool, "/vendor/block", data=False).success
    stood = stands(client)
    client.until(lambda: client.trigger("reset").success)
    to_motion(client)
    np.testing.assert_allclose(stands(client), stood, atol=2e-3)
    assert client.move(client.home).success

    assert client.call(SetBool, "/vendor/refuse", data=True).success
    assert not client.move(client.home + 0.05).success
    assert "/vendor_controller/follow_joint_trajectory refused the trajectory" in estopped(client)


def test_servers_are_counted(vendor, config, without_testbed):
    client = follow(vendor, config, without_testbed)
    second = vendor("trajectory")
    assert "there are 2 servers of /vendor_controller/follow_joint_trajectory; 1 is needed" in estopped(client)
    assert not client.trigger("reset").success
    second.send_signal(signal.SIGINT)
    client.until(lambda: client.trigger("reset").success)  # once it has said that it ends
    to_motion(client)
    assert client.move(client.home + 0.05).success


def test_a_process_that_dies_leaves_no_goal_behind(vendor, config, without_testbed):
    client = follow(vendor, config, without_testbed)
    _, result = client.start_far_move()
    client.until(lambda: np.abs(np.array(client.group_state().q) - client.home).max() > 0.05)
    (bridge,) = [
        int(entry.name)
        for entry in Path("/proc").glob("[0-9]*")
        if b"im_mcs.ros.trajectory_channels" in command_of(entry) and names.instance().encode() in command_of(entry)
    ]
    os.kill(bridge, signal.SIGKILL)
    assert not result().success
    assert "im_mcs.ros.trajectory_channels" in estopped(client)
    client.until(lambda: client.trigger("reset").success)  # another one is there
    stood = stands(client)
    assert np.abs(stood - client.home).max() > 0.01
    clock.sleep(1.0)
    np.testing.assert_allclose(stands(client), stood, atol=1e-3)


def command_of(entry):
    try:
        return (entry / "cmdline").read_bytes()
    except OSError:
        return b""


def test_a_vendor_that_slows_down_and_halts_by_its_slider_is_gone_along_with(vendor, config, without_testbed):
    vendor("trajectory")
    client = without_testbed(config=config("trajectory"), use_sim_time=False)  # a following error would be noticed
    to_motion(client)
    slider = client.node.create_publisher(Float64, "/vendor/slider", qos.LATCHED)
    client.until(slider.get_subscription_count)
    far = client.home + 0.4
    _, result = client.start_move(far)
    client.until(lambda: np.abs(np.array(client.group_state().q) - client.home).max() > 0.02)
    slider.publish(Float64(data=0.4))
    client.until(lambda: np.abs(np.array(client.group_state().q) - client.home).max() > 0.1)
    slider.publish(Float64(data=0.0))
    stood = stands(client)
    assert np.abs(stood - far).max() > 0.05
    assert client.state() == "motion"
    slider.publish(Float64(data=1.0))
    assert result().success
    np.testing.assert_allclose(stands(client), far, atol=0.01)
