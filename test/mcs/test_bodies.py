"""Free bodies gripped by MCS, carried, let go, and met by a guarded move; truth is asked of the testbed."""

import copy
import json

import numpy as np
import pinocchio as pin
import pytest
from control_msgs.action import GripperCommand
from geometry_msgs.msg import Pose

from im_cell.robot import load_cell, urdf
from im_core.config import package_file
from im_core.ros.calls import call_blocking
from im_msgs.action import Move
from im_msgs.srv import Advance, GetTruth, InverseKinematics, PlaceObject
from support.mcs_config import write_mcs_config


@pytest.fixture
def client(run_machine, tmp_path, monkeypatch):
    monkeypatch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/objects.yaml")))
    config = write_mcs_config(tmp_path, protective={"patience_s": 600.0}, safety={"owner_silence_s": 60.0})
    with run_machine(config) as client:
        client.to_cold()
        yield client


def truth(client, name):
    """Pose of a free body as the testbed knows it."""
    return json.loads(client.call(GetTruth, "/testbed/get_truth").json)["objects"][name]


def between_jaws(q):
    """Frame between the left jaws: as the wrist's there."""
    cell = load_cell()
    model = pin.buildModelFromXML(urdf(cell, shapes=False))
    data, whole = model.createData(), cell.home.copy()
    whole[:9] = q
    pin.framesForwardKinematics(model, data, whole)
    wrist = data.oMf[model.getFrameId("left_wrist")]
    return wrist * pin.SE3(np.eye(3), np.array([0.0, 0.0, cell.gripper.reach]))


def grip(client, position, effort):
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = position, effort
    return client.act(GripperCommand, "/left_gripper/gripper_cmd", goal)[1]()


def line(client, pose, **fields):
    return client.act(Move, "/left/move", Move.Goal(line=[pose], **fields))[1]().result


def test_a_block_is_gripped_carried_and_let_go(client):
    client.to_motion()
    block = load_cell().objects[0]
    grip(client, block.size[0] + 0.006, 60.0)
    frame = between_jaws(client.group_state().q)
    # its long axis along y of the wrist: across the jaws, which open along x
    turned = frame * pin.SE3(pin.rpy.rpyToMatrix(1.5707963267948966, 0.0, 0.0), np.zeros(3))
    request = PlaceObject.Request(name="block")
    p, o = request.pose.position, request.pose.orientation
    p.x, p.y, p.z, o.x, o.y, o.z, o.w = pin.SE3ToXYZQUAT(turned).tolist()
    placing = client.node.create_client(PlaceObject, "/testbed/place_object")
    answer = call_blocking(placing, request, 60.0, "object")
    assert answer.success, answer.message
    held = grip(client, 0.0, 60.0).result
    assert (held.stalled, held.reached_goal) == (True, False)
    assert held.position == pytest.approx(block.size[0], abs=2e-3)
    assert held.effort == pytest.approx(60.0, rel=0.2)

    before = truth(client, "block")
    q = client.home.copy()
    q[0] -= 0.4
    assert client.move(q).success
    after = truth(client, "block")
    assert after[0] - before[0] == pytest.approx(-0.4, abs=5e-3), "it went along"
    assert after[1:3] == pytest.approx(before[1:3], abs=5e-3)

    assert grip(client, 0.08, 60.0).result.reached_goal
    assert client.call(Advance, "/testbed/advance", duration=2.0).success
    assert truth(client, "block")[2] < before[2] - 0.01, "it fell out of the jaws"


def test_a_guarded_move_ends_on_the_block_below_and_fails_over_nothing(client):
    client.to_motion()
    before = truth(client, "block")
    above = Pose()
    above.position.x, above.position.y = before[:2]
    above.position.z = before[2] + 0.08 + load_cell().gripper.reach + 0.08  # its half height, and room for the jaws
    above.orientation.x, above.orientation.w = 1.0, 0.0  # straight down
    answer = client.call(InverseKinematics, "inverse_kinematics", group="left", wrist=above, avoid_collisions=True)
    assert answer.success, answer.status.message
    assert client.move(list(answer.q)).success
    below = copy.deepcopy(above)
    below.position.z -= 0.12
    result = line(client, below, line_speed=0.03, until_force=15.0)
    assert result.success, result.status.message
    assert 15.0 <= result.force < 80.0
    assert before[2] + 0.04 < result.state.wrist.position.z - load_cell().gripper.reach < above.position.z
    assert truth(client, "block")[:3] == pytest.approx(before[:3], abs=6e-3), "pressed, not pushed away"
    assert line(client, above).success
    above.position.z += 0.02
    nothing = line(client, above, line_speed=0.03, until_force=15.0)
    assert not nothing.success
    assert nothing.status.code == "no_contact"
    assert "no contact on the way" in nothing.status.message
