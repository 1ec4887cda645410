"""Each layer's topics: what shows it, and what drives it for the owner of the slots; partitions and leases."""

import math

import numpy as np
import pinocchio as pin
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, Pose, Quaternion, WrenchStamped
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_cell.robot import load_cell
from im_core import clock
from im_mcs.model import CellModel
from im_msgs.action import Move
from im_msgs.msg import GroupSetpoints, GroupTorques, SetpointCommand, SlotStates, TorqueCommand
from im_msgs.srv import Advance, RenewLease, ReserveGroup, SetPartition

STEP = np.array([0.05, 0.2, 0.1, 0.2, -0.2, 0.2, 0.3, 0.3, 0.3])


def refused(client, topic, diagnostics):
    """How many messages of a topic were refused, as ``/diagnostics`` says."""
    values = [v for m in diagnostics for s in m.status for v in s.values if v.key == topic]
    return int(values[-1].value) if values else 0


def test_every_layer_shows_itself(ready):
    slots = ready.listen(SlotStates, "/mcs/slots")
    wrench = ready.listen(WrenchStamped, "/left_wrist/wrench")
    torques = ready.listen(GroupTorques, "/left/torques")
    setpoints = ready.listen(GroupSetpoints, "/left/setpoints")
    target = ready.home + STEP
    result = ready.move(target)
    assert result.success
    ready.until(lambda: slots and wrench and len(torques) > 20 and len(setpoints) > 20)
    last = slots[-1]
    assert list(last.joints[:9]) == ready.joints
    assert len(last.drivers) == len(last.position) == len(last.age) == 18
    assert all(":" in driver for driver in last.drivers)
    assert max(last.age) < 0.05
    assert list(last.grippers) == ["left_gripper", "right_gripper"]
    assert list(last.wrists) == ["left_wrist", "right_wrist"]
    assert wrench[-1].header.frame_id == "left_wrist"
    assert np.isfinite([wrench[-1].wrench.force.z, wrench[-1].wrench.torque.x]).all()
    assert list(torques[-1].joints) == ready.joints
    assert torques[-1].controller.endswith(":PidGravity")
    np.testing.assert_allclose(setpoints[-1].position, target, atol=1e-6)
    q = np.array([m.position for m in setpoints])
    v = np.array([m.velocity for m in setpoints])
    t = np.array([m.stamp.sec + 1e-9 * m.stamp.nanosec for m in setpoints])
    moving = np.abs(np.diff(t) - 0.02) < 0.006
    slopes = np.diff(q, axis=0)[moving] / np.diff(t)[moving, None]
    np.testing.assert_allclose(slopes, ((v[1:] + v[:-1]) / 2)[moving], atol=0.05)


def test_a_tare_lets_the_wrench_of_a_wrist_begin_at_zero_and_slots_as_they_are(ready):
    slots = ready.listen(SlotStates, "/mcs/slots")
    wrench = ready.listen(WrenchStamped, "/left_wrist/wrench")

    def mean():
        """Forces of the topic and of the slots, at rest."""
        assert ready.move(ready.home).success
        wrench.clear()
        slots.clear()
        assert ready.call(Advance, "/testbed/advance", duration=1.0).success  # else time stands, and messages are rare
        ready.until(lambda: len(wrench) > 20 and len(slots) > 20)
        forces = ([m.wrench.force for m in wrench], [m.wrenches[0].force for m in slots])
        return [np.mean([[f.x, f.y, f.z] for f in each], axis=0) for each in forces]

    before, raw = mean()
    np.testing.assert_allclose(before, raw, atol=0.2)
    assert np.linalg.norm(before) > 1.0  # the weight of gripper and light
    answer = ready.call(Trigger, "/left_wrist/tare")
    assert answer.success, answer.message
    assert "/left_wrist/wrench is zero now" in answer.message
    after, still = mean()
    np.testing.assert_allclose(after, np.zeros(3), atol=0.15)
    np.testing.assert_allclose(still, raw, atol=0.2)


def test_the_owner_drives_setpoints(client):
    client.to_motion(owner="me")
    client.until(lambda: client.status().owner == "me")
    publisher = client.talk(SetpointCommand, "/left/command/setpoints")
    start = np.array(client.group_state().q_rest)
    target = start + 0.1 * np.eye(9)[3]
    for _ in range(40):
        publisher.publish(SetpointCommand(owner="me", lease=1.0, joints=client.joints, position=target.tolist()))
        clock.sleep(0.02)
    client.until(lambda: abs(client.group_state().q[3] - target[3]) < 1e-3)
    client.until(lambda: client.group_state().at_rest)  # the lease lapses: it holds


def test_the_owner_drives_torques_and_a_lapsed_lease_holds(client):
    client.to_motion(owner="me")
    publisher = client.talk(TorqueCommand, "/left/command/torques")
    torques = client.listen(GroupTorques, "/left/torques")
    client.until(lambda: torques)
    held = list(torques[-1].torque)
    publisher.publish(TorqueCommand(owner="me", lease=0.05, torque=held))
    client.until(lambda: any(list(m.torque) == held for m in torques[1:]))
    client.until(lambda: client.group_state().at_rest)


def test_wrong_commands_are_refused_and_counted(client):
    client.to_motion(owner="me")
    diagnostics = client.listen(DiagnosticArray, "/diagnostics")
    q = client.group_state().q_rest
    publisher = client.talk(SetpointCommand, "/left/command/setpoints")
    before = refused(client, "/left/command/setpoints", diagnostics)
    wrong = (
        SetpointCommand(owner="you", lease=1.0, position=q),
        SetpointCommand(owner="me", lease=1.0, position=q[:8]),
        SetpointCommand(owner="me", lease=1.0, position=[math.nan] * 9),
        SetpointCommand(owner="me", lease=math.inf, position=q),
        SetpointCommand(owner="me", lease=1.0, joints=["left_j1"], position=q),
        SetpointCommand(owner="me", lease=1.0, position=[9.0] * 9),
    )
    for message in wrong:
        publisher.publish(message)
    client.until(lambda: refused(client, "/left/command/setpoints", diagnostics) >= before + len(wrong))
    assert client.group_state().q_rest == q


def test_owner_and_lease(client):
    for fields, sentence in (
        ({"owner": "me", "lease": math.nan}, "lease is nan"),
        ({"owner": "me", "lease": -1.0}, "lease_s"),
    ):
        answer = client.call(ReserveGroup, "reserve", group="left", **fields)
        assert not answer.success
        assert sentence in answer.message
    client.to_motion(owner="me", lease=0.5)
    answer = client.call(RenewLease, "renew", owner="me")
    assert answer.success, answer.message
    answer = client.call(RenewLease, "renew", owner="you")
    assert not answer.success
    assert "you" in answer.message
    client.until(lambda: client.status().owner == "me")
    result = client.move(client.home + np.eye(9)[0], speed_scale=0.1)  # longer than the lease
    assert not result.success
    assert "lease" in result.status.message


def test_partition_without_a_restart(client):
    assert list(client.states[-1].reserved_groups) == []
    assert not client.call(SetPartition, "set_partition", preset="4x4").success
    try:
        answer = client.call(SetPartition, "set_partition", preset="3x6")
        assert answer.success, answer.message
        assert answer.message == "the groups are left, right, transporter"
        client.until(lambda: client.states[-1].preset == "3x6" and len(client.states[-1].groups) == 3)
        client.to_motion(group="transporter")
        q = client.group_state("transporter").q_rest
        assert len(q) == 6
        result = client.move([x + 0.05 for x in q], group="transporter")
        assert result.success, result.status.message
        result = client.move(q, group="testbed")
        assert "group 'testbed' is not in the preset in force, 3x6" in result.status.message
        answer = client.call(SetPartition, "set_partition", preset="2x9")
        assert not answer.success
        assert "release first" in answer.message
    finally:
        client.to_cold()
        assert client.call(SetPartition, "set_partition", preset="2x9").success


def test_both_arms_move_as_one(client):
    """Over ROS: the first arm by its joints alone, an arc, and the second wrist in the frame of the first."""
    model = CellModel(load_cell())

    def apart():
        q = np.array(client.group_state("testbed").q)
        return model.pose(q, "left_wrist").actInv(model.pose(q, "right_wrist"))

    def act(**fields):
        return client.act(Move, "/testbed/move", Move.Goal(**fields))[1]().result

    def pose(se3):
        x, y, z, *turn = pin.SE3ToXYZQUAT(se3).tolist()
        return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(**dict(zip("xyzw", turn, strict=True))))

    try:
        answer = client.call(SetPartition, "set_partition", preset="1x18")
        assert answer.success, answer.message
        client.until(lambda: client.states[-1].preset == "1x18")
        client.to_motion(group="testbed")
        q = np.array(client.group_state("testbed").q_rest)
        q[7] = q[16] = 0.8
        assert client.move(q.tolist(), group="testbed").success
        begin = apart()
        points = [JointTrajectoryPoint(positions=(q[:9] + np.array([0, 0, 0, 0.05, 0.05, 0, 0.1, 0, 0.1])).tolist())]
        result = act(path=JointTrajectory(joint_names=client.joints, points=points))
        assert result.success, result.status.message
        np.testing.assert_allclose(apart().homogeneous, begin.homogeneous, atol=5e-4)
        wrist = model.pose(np.array(client.group_state("testbed").q_rest), "left_wrist")
        steps = [pin.SE3(wrist.rotation, wrist.translation + step) for step in ([0.02, 0.02, 0.0], [0.02, 0.05, 0.01])]
        beside = begin * pin.SE3(np.eye(3), np.array([0.02, 0.0, 0.03]))
        result = act(line=[pose(each) for each in steps], arc=True, relative=[pose(beside)], line_speed=0.1)
        assert result.success, result.status.message
        np.testing.assert_allclose(apart().homogeneous, beside.homogeneous, atol=5e-4)
        result = act(relative=[pose(begin)])
        assert result.success, result.status.message
        np.testing.assert_allclose(apart().homogeneous, begin.homogeneous, atol=5e-4)
        for fields, words in (
            ({"arc": True, "relative": [pose(begin)]}, "arc is for a line"),
            ({"arc": True, "line": [pose(wrist)]}, "arcs need two poses each"),
            ({"relative": [Pose(orientation=Quaternion(w=0.5))]}, "relative pose 1"),
            ({"line": [pose(wrist)], "relative": [pose(begin)] * 2}, "2 relative poses are given for 1"),
            ({"path": JointTrajectory(joint_names=client.joints, points=points), "line_speed": 0.1}, "line_speed"),
        ):
            assert words in act(**fields).status.message
    finally:
        client.to_cold()
        assert client.call(SetPartition, "set_partition", preset="2x9").success


def test_two_groups_move_at_the_same_time(client):
    assert client.call(ReserveGroup, "reserve", group="right").success
    client.to_motion()
    right = client.group_state("right").q_rest
    _, left_done = client.start_move(client.home + STEP)
    _, right_done = client.start_move(np.array(right) + STEP * 0.5, group="right")
    assert left_done().success
    assert right_done().success
