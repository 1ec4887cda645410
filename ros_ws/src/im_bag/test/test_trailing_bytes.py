"""Messages written by ``rclpy.serialization`` have bytes behind the end, where lists of numbers are empty."""

import struct

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState, MultiDOFJointState

from im_bag.reading import deserialized

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPE, LISTS = "sensor_msgs/msg/JointState", ("position", "velocity", "effort")
GIVEN = [{}, {"position": [1.0]}, {"effort": [1.0, 2.0]}, {"velocity": [3.0]}, {name: [1.0] for name in LISTS}]


@pytest.mark.parametrize("given", GIVEN)
@pytest.mark.parametrize("name", ["", "j", "j1", "j12", "j123"])
def test_what_rclpy_writes_is_read(given, name):
    read = deserialized(STORE, serialize_message(JointState(name=[name], **given)), TYPE)
    assert read.name == [name]
    assert {key: list(getattr(read, key)) for key in LISTS} == {key: given.get(key, []) for key in LISTS}


@pytest.mark.parametrize("given", GIVEN)
def test_what_others_write_is_read(given):
    header = STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](1, 2), "base")
    lists = {key: np.array(given.get(key, [])) for key in LISTS}
    written = STORE.serialize_cdr(STORE.types[TYPE](header=header, name=["j1"], **lists), TYPE)
    read = deserialized(STORE, written, TYPE)
    assert {key: list(getattr(read, key)) for key in LISTS} == {key: given.get(key, []) for key in LISTS}


def test_lists_of_messages_are_read():
    data = serialize_message(MultiDOFJointState(joint_names=["base"]))
    assert deserialized(STORE, data, "sensor_msgs/msg/MultiDOFJointState").joint_names == ["base"]


@pytest.mark.parametrize("length", [21, 64])
def test_more_bytes_than_that_are_refused(length):
    data = serialize_message(JointState(name=["j"], position=[1.0], velocity=[1.0], effort=[1.0]))
    with pytest.raises(SerdeError, match="size mismatch"):
        deserialized(STORE, data + bytes(length), TYPE)


@pytest.mark.parametrize("data", [b"", b"\x00\x01\x00\x00\xff\xff", b"\x07\x01\x00\x00" + bytes(60)])
def test_a_message_that_is_none_is_refused(data):
    with pytest.raises((SerdeError, struct.error, ValueError, IndexError)):
        deserialized(STORE, data, TYPE)
