"""Recorded slot data played back as readings."""

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from im_core.config import package_file
from im_core.errors import ConfigError, DataError, LinkError
from im_mcs.testbed import Drive
from im_mcs.testbed.bag import BagDriver

JOINTS = ("a", "b", "c")
PERIOD_S = 0.005
HELD = Drive(np.zeros(2), True, np.zeros(2, dtype=bool), np.zeros(0), True, np.zeros(0))


def joint_states(store, names_and_positions, stamp_ns):
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    names, positions = zip(*names_and_positions, strict=True)
    none = np.zeros(0)
    return types["sensor_msgs/msg/JointState"](
        header=header, name=list(names), position=np.array(positions), velocity=none, effort=none
    )


def write(path, plugin, messages):
    """Joint states ``[(stamp_ns, {name: position})]`` as a bag."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kind = "sensor_msgs/msg/JointState"
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for stamp_ns, positions in messages:
            data = store.serialize_cdr(joint_states(store, positions.items(), stamp_ns), kind)
            writer.write(connection, 10**18 + stamp_ns, data)
    return path


def play(driver, ticks):
    readings = []
    for _ in range(ticks):
        readings.append(driver.read())
        driver.write(HELD)
    return readings


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_readings_come_at_their_recorded_times(tmp_path, plugin):
    start, step = 7_000_000_000, 20_000_000
    messages = [(start + k * step, {"c": 1.0 + k, "a": -1.0 * k, "b": 50.0}) for k in range(10)]
    driver = BagDriver(str(write(tmp_path / "bag", plugin, messages)), ["a", "c"], period_s=PERIOD_S, pace="lockstep")
    assert driver.wall_period_s == 0.0
    readings = play(driver, 100)
    for tick, m in enumerate(readings):
        k = min(tick // 4, 9)
        assert (m.tick, m.stamp_ns) == (tick, tick * 5_000_000)
        np.testing.assert_allclose(m.q, [-1.0 * k, 1.0 + k])
        np.testing.assert_allclose(m.age_s, tick * PERIOD_S - k * 0.02, atol=1e-8)
    assert readings[-1].age_s.min() > 0.3, "the last reading stays, and grows old"
    assert readings[1].power
    assert not readings[1].brakes.any()


def test_a_joint_left_out_of_some_messages_is_old(tmp_path):
    messages = [(k * 5_000_000, {"a": float(k), "b": 0.5} if k % 4 == 0 else {"a": float(k)}) for k in range(9)]
    driver = BagDriver(str(write(tmp_path / "bag", StoragePlugin.MCAP, messages)), ["b", "a"], period_s=PERIOD_S)
    assert driver.wall_period_s == PERIOD_S
    ages = np.array([m.age_s for m in play(driver, 9)])
    np.testing.assert_allclose(ages[:, 1], 0.0, atol=1e-8)
    np.testing.assert_allclose(ages[:, 0], [0.005 * (k % 4) for k in range(9)], atol=1e-8)


def test_a_bag_of_two_starts_of_a_testbed_is_refused(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    kind = "sensor_msgs/msg/JointState"
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for k, stamp_ns in enumerate((10**9, 2 * 10**9, 25 * 10**8, 0, 10**9)):
            data = store.serialize_cdr(joint_states(store, [("a", float(k))], stamp_ns), kind)
            writer.write(connection, 10**18 + k * 10**9, data)
    with pytest.raises(DataError, match=r"fall from 2\.500 to 0\.000 s, 3\.000 s after its first message"):
        BagDriver(str(tmp_path / "bag"), ["a"])


def test_an_end_may_be_a_fault(tmp_path):
    bag = write(tmp_path / "bag", StoragePlugin.MCAP, [(k * 10_000_000, {"a": 0.1}) for k in range(3)])
    driver = BagDriver(str(bag), ["a"], period_s=PERIOD_S, at_end="fault")
    assert len(play(driver, 5)) == 5
    with pytest.raises(LinkError, match=r"bag ended: '.*bag' has nothing on '/joint_states' after 0.020 s"):
        driver.read()


def test_slot_states_bring_grippers_and_wrenches(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    text = (package_file("im_mcs", "config/mcs.yaml").parents[3] / "im_msgs/msg/SlotStates.msg").read_text()
    kind = "im_msgs/msg/SlotStates"
    store.register(get_types_from_msg(text, kind))
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/mcs/slots", kind, typestore=store)
        for k in range(3):
            wrench = types["geometry_msgs/msg/Wrench"](force=vector(1.0, 2.0, 3.0), torque=vector(4.0, 5.0, 6.0 + k))
            message = types[kind](
                stamp=types["builtin_interfaces/msg/Time"](sec=3, nanosec=k * 5_000_000), tick=k,
                joints=["x", "y"], drivers=["", ""], position=np.array([0.1, 0.2]), velocity=np.zeros(2),
                torque=np.zeros(2), age=np.zeros(2), brakes=np.zeros(2, dtype=bool), grippers=["left", "right"],
                opening=np.array([0.01, 0.02 + k]), grip_force=np.array([30.0, 40.0]),
                wrists=["left_wrist"], wrenches=[wrench],
            )  # fmt: skip
            writer.write(connection, k, store.serialize_cdr(message, kind))
    driver = BagDriver(
        str(tmp_path / "bag"), ["y"], "/mcs/slots", grippers=["right", "left"], wrists=["left_wrist"], period_s=PERIOD_S
    )
    m = play(driver, 3)[2]
    np.testing.assert_allclose(m.q, [0.2])
    np.testing.assert_allclose(m.gripper, [2.02, 0.01])
    np.testing.assert_allclose(m.gripper_force, [40.0, 30.0])
    np.testing.assert_allclose(m.wrench, [[1, 2, 3, 4, 5, 8]])


def test_what_a_bag_lacks_is_named(tmp_path):
    bag = str(write(tmp_path / "bag", StoragePlugin.MCAP, [(0, {"a": 0.1, "b": 0.2})]))
    with pytest.raises(DataError, match="'/joint_states' says nothing of joint d; it has a, b"):
        BagDriver(bag, ["a", "d"])
    with pytest.raises(DataError, match="'/joint_states' says nothing of gripper left; it has none"):
        BagDriver(bag, ["a"], grippers=["left"])
    with pytest.raises(DataError, match=r"there is no topic '/states' in it \(did you mean '/joint_states'\?\)"):
        BagDriver(bag, ["a"], "/states")
    with pytest.raises(DataError, match="nowhere: cannot be read"):
        BagDriver(str(tmp_path / "nowhere"), ["a"])
    with pytest.raises(ConfigError, match=r"pace of the driver of bag '.*' is 'fast', not recorded or lockstep"):
        BagDriver(bag, ["a"], pace="fast")
