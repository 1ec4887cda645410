"""Machines of shipped cells other than the pair of PUMAs: started by name, moved, led along a line, stopped."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import yaml

from im import Machine as Client
from im import MachineError
from im_cell.robot import load_cell
from support.whole_machine import free_port, report_of, run_script, running_machine

#: Of each cell; a UR5 is started, moved and calibrated by the tutorial (``tutorials/cell.md``).
COMMANDS = {
    "so101": {"home", "move", "look", "calibrate_camera"},
    "ur_pair": {"home", "move", "look", "calibrate_camera", "demo"},
    "panda": {"home", "move", "look", "calibrate_camera", "open_gripper", "close_gripper", "pick", "place"},
}


@pytest.fixture(scope="module", params=COMMANDS)
def cell(request):
    return request.param, load_cell(request.param)


@pytest.fixture(scope="module")
def group(cell):
    """The first arm."""
    return next(iter(cell[1].groups))


@pytest.fixture(scope="module")
def machine(cell):
    with running_machine("--cell", cell[0]) as machine:
        yield machine


def test_it_moves_draws_a_line_and_stops(machine, cell, group):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    from im_core.ros import qos
    from im_core.ros.guard import GuardedActionClient
    from im_msgs.action import Move
    from im_msgs.srv import GetGroupState, ReserveGroup

    shipped = cell[1]
    move = GuardedActionClient(machine.node, Move, f"/{group}/move")
    machine.wait_for(move.server_is_ready, f"/{group}/move")

    def moved(goal):
        sent = move.send_goal_async(goal)
        machine.wait_for(sent.done, "a goal to be taken")
        ended = sent.result().get_result_async()
        machine.wait_for(ended.done, "a move to end", 240.0)
        return ended.result().result

    def state():
        return machine.call(GetGroupState, "/mcs/get_group_state", group=group).state

    heard = []
    machine.node.create_subscription(JointState, "/joint_states", heard.append, qos.EVENTS)
    names = [*shipped.joint_names, *shipped.devices("gripper")]
    described = ET.fromstring(machine.message(String, "/robot_description", profile=qos.LATCHED).data)
    assert set(names) <= {joint.get("name") for joint in described.findall("joint")}
    assert machine.call(ReserveGroup, "/mcs/reserve", group=group).success
    for asked in ("/mcs/power_on", "/mcs/enable_motion"):
        answer = machine.trigger(asked)
        assert answer.success, answer.message
    joints = shipped.joints_of(group)
    target = np.add(shipped.groups[group].home, 0.1)
    points = [JointTrajectoryPoint(positions=target.tolist())]
    answer = moved(Move.Goal(path=JointTrajectory(joint_names=list(joints), points=points)))
    assert answer.success, answer.status.message
    np.testing.assert_allclose(state().q, target, atol=5e-4)
    machine.wait_for(lambda: heard, "/joint_states")
    assert list(heard[0].name) == names
    pose = state().wrist
    pose.position.z -= 0.04
    answer = moved(Move.Goal(line=[pose], line_speed=0.1))
    assert answer.success, answer.status.message
    assert state().wrist.position.z == pytest.approx(pose.position.z, abs=5e-4)
    assert machine.trigger("/mcs/estop").success
    answer = moved(Move.Goal(line=[pose]))
    assert not answer.success
    assert "estopped" in answer.status.message
    assert machine.trigger("/mcs/reset").success  # an emergency stop outlives its machine


def test_a_client_finds_the_groups_of_the_cell_by_their_names(machine, cell, group):
    shipped = cell[1]
    with Client.connect(timeout=60.0) as im:
        assert list(im.groups) == list(shipped.groups)
        assert {*shipped.groups} <= {*dir(im)}
        arm = getattr(im, group)
        assert list(arm.joints) == list(shipped.joints_of(group))
        there_are = f"there is no group 'left'; there are {', '.join(shipped.groups)}"
        with pytest.raises(MachineError, match=there_are):
            im.group("left")
        with pytest.raises(AttributeError, match=f"a machine has no 'left': {there_are}"):
            _ = im.left
        with arm.reserved(lease=30.0) as arm:
            joint, position = next(iter(arm.joints.items()))
            arm.move_joints(**{joint: position + 0.05})
            assert arm.joints[joint] == pytest.approx(position + 0.05, abs=1e-3)
            if shipped.groups[group].gripper:
                assert arm.gripper.close() < arm.gripper.open()


def test_its_commands_are_those_that_its_parts_allow(machine, cell, group):
    from std_msgs.msg import String

    from im_core.ros import qos
    from im_msgs.srv import GetGroupState

    name, shipped = cell
    told = json.loads(machine.message(String, "/dispatcher/commands", profile=qos.LATCHED).data)
    assert {command["symbol"] for command in told["commands"]} == COMMANDS[name]
    if len(shipped.groups) == 1:
        refused = run_script("im", "run", "demo")
        assert refused.returncode == 2
        assert "demo is left out: " in refused.stderr
        assert "it needs 2 of the arms of the cell, which has 1" in refused.stderr
    home = shipped.groups[group].home
    turned = np.add(home, 0.1).tolist()
    answer = machine.execute("move", group=group, joints=turned)()
    assert answer.success, answer.message
    np.testing.assert_allclose(
        machine.call(GetGroupState, "/mcs/get_group_state", group=group).state.q, turned, atol=5e-4
    )
    answer = machine.execute("home")()
    assert answer.success, answer.message
    there = machine.call(GetGroupState, "/mcs/get_group_state", group=group).state.q
    np.testing.assert_allclose(there, home, atol=5e-4)
    if shipped.devices("gripper"):
        answer = machine.execute("close_gripper", width=0.02)()
        assert answer.success, answer.message
        assert json.loads(answer.results)["width"] == pytest.approx(0.02, abs=1e-3)


def test_its_cameras_are_calibrated_by_the_light_on_its_wrist(machine, cell, group, tmp_path):
    """The truth is asked only afterwards."""
    from im_msgs.srv import GetTruth

    shipped = cell[1]
    few = yaml.safe_load(Path(shipped.poses).read_text())
    few["poses"] = few["poses"][:14]
    (tmp_path / "few.yaml").write_text(yaml.safe_dump(few))
    answer = machine.calibrate(tmp_path / "few.yaml")
    assert answer.success, answer.message
    report = report_of(answer)
    assert [camera["name"] for camera in report["cameras"]] == list(shipped.cameras)
    assert report["points_used"] >= 12
    assert report["verdicts"] == []
    places, expected = np.array([pose["position_m"] for pose in few["poses"]]), report["expected_error"]
    assert (np.array(expected["workspace_low_m"]) > places.min(axis=0) - 0.2).all(), "where this arm has its light"
    assert (np.array(expected["workspace_high_m"]) < places.max(axis=0) + 0.2).all()
    truth = json.loads(machine.call(GetTruth, "/testbed/get_truth").json)
    for camera in report["cameras"]:
        true = np.array(truth["cameras"][camera["name"]]["K"])[0, 0]
        assert np.array(camera["K"])[0, 0] == pytest.approx(true, rel=0.02), "focal length"
    off = np.array(report["led_offset_m"]) - truth["leds"][f"{group}_led"]["offset_m"]
    assert (np.abs(off) < 5.0 * np.array(report["led_offset_standard_deviation_m"]) + 1e-4).all()


def test_what_the_cell_lacks_is_not_there_and_said(machine, cell):
    names = {name for name, _ in machine.node.get_topic_names_and_types()}
    assert ("/arm_gripper/gripper_cmd/_action/status" in names) == bool(cell[1].devices("gripper"))
    assert not [name for name in names if "left" in name or "force" in name or "laser" in name]
    grasping = {"gripper_coordinator"} if cell[1].devices("gripper") else set()
    rest = {
        "testbed",
        "mcs",
        "vss",
        "vision_coordinator",
        "dom",
        "pnt_display",
        "dispatcher",
        "motion_coordinator",
        "path_planning_coordinator",
    }
    assert set(machine.tasks) == rest | grasping


def test_a_start_says_which_tasks_it_leaves_out_and_refuses_a_cell_that_is_not_there(tmp_path):
    started = run_script("start", "--cell", "ur55", "--port", free_port())
    assert started.returncode == 2
    assert "ur55" in started.stderr
    assert "did you mean 'ur5'" in started.stderr
