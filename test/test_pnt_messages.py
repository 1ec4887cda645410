"""Messages as plain data and the reverse, types of fields, and data objects as guards look at them."""

import math

import pytest
from geometry_msgs.msg import Point, PoseStamped, PoseWithCovariance
from sensor_msgs.msg import BatteryState, CompressedImage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_core.errors import ConfigError, DataError, ImError
from im_core.ros.messages.message_fields import filled
from im_pnt.execution.values import ObjectPendingError
from im_pnt_node.ros.messages import RosTypes, plain_fields
from im_pnt_node.ros.objects.objects import DomObjects


def test_fields_of_messages_have_types():
    fields = RosTypes().fields("control_msgs/action/GripperCommand_Goal")
    assert {name: str(kind) for name, kind in fields.items()} == {"command": "control_msgs/msg/GripperCommand"}
    fields = RosTypes().fields("trajectory_msgs/msg/JointTrajectory")
    assert str(fields["points"]) == "a list of trajectory_msgs/msg/JointTrajectoryPoint"
    assert str(RosTypes().fields("geometry_msgs/msg/PoseWithCovariance")["covariance"]) == "a list of 36 numbers"
    assert str(RosTypes().fields("std_srvs/srv/SetBool_Response")["success"]) == "true or false"
    with pytest.raises(
        ConfigError, match=r"no msg type of std_msgs 'Strng'; did you mean 'String'.*was sourced before"
    ):
        RosTypes().fields("std_msgs/msg/Strng")


def test_what_is_kept_is_what_was_asked_for_and_makes_the_same_message_again():
    points = [JointTrajectoryPoint(positions=[0.5, 1.0]), JointTrajectoryPoint(positions=[2.0])]
    message = JointTrajectory(joint_names=["a", "b"], points=points)
    assert plain_fields(message, (), "m") == {}
    assert plain_fields(message, [("joint_names",), ("points", "positions")], "m") == {
        "joint_names": ["a", "b"],
        "points": [{"positions": [0.5, 1.0]}, {"positions": [2.0]}],
    }
    whole = plain_fields(message, [()], "m")
    assert filled(JointTrajectory(), whole, "m") == message
    assert filled(JointTrajectory(), {"joint_names": ("a", "b"), "points": points}, "m") == message
    pose = PoseWithCovariance(covariance=[float(number) for number in range(36)])
    assert plain_fields(pose, [("covariance",)], "m") == {"covariance": [float(number) for number in range(36)]}
    image = CompressedImage(data=[1, 2, 255])
    assert plain_fields(image, [("data",)], "m") == {"data": [1, 2, 255]}
    nested = plain_fields(PoseStamped(), [("pose", "position", "x"), ("header", "frame_id")], "m")
    assert nested == {"pose": {"position": {"x": 0.0}}, "header": {"frame_id": ""}}


def test_a_number_that_is_not_finite_is_kept_by_nobody():
    message = BatteryState(percentage=math.nan, voltage=12.0)
    assert plain_fields(message, [("voltage",)], "the answer") == {"voltage": 12.0}
    with pytest.raises(ImError, match=r"^the answer.percentage is nan, which is no finite number and cannot be kept$"):
        plain_fields(message, [("percentage",)], "the answer")
    with pytest.raises(DataError, match=r"^m.percentage "):
        filled(BatteryState(), {"percentage": "low"}, "m")


class Dom:
    """A Data Object Manager that answers when the test says so."""

    def __init__(self):
        self.objects, self.asked = {"a/spot": Point(x=1.0)}, []

    async def get(self, name, kind):
        self.asked.append(name)
        if name not in self.objects:
            raise DataError(f"there is no {name}")
        return self.objects[name]


def test_a_guard_sees_an_object_once_it_was_read_and_not_what_it_was_before_a_change():
    dom, works, known = Dom(), [], []
    objects = DomObjects(dom, works.append, lambda: known.append(True))

    def look(name="a/spot"):
        return objects.latest(name, "geometry_msgs/msg/Point", [("x",)])

    def work():
        with pytest.raises(StopIteration):
            works.pop(0).send(None)

    with pytest.raises(ObjectPendingError, match="data object a/spot is being read"):
        look()
    with pytest.raises(ObjectPendingError):
        look()
    assert len(works) == 1, "it is asked for once"
    work()
    assert known == [True]
    assert look() == {"x": 1.0}
    assert not objects.forget("b/spot")
    dom.objects["a/spot"] = Point(x=2.0)
    assert objects.forget("a/spot")
    with pytest.raises(ObjectPendingError):
        look()
    objects.stale()
    with pytest.raises(ObjectPendingError):
        look()
    work()
    with pytest.raises(ObjectPendingError):
        look()  # that was the one before
    work()
    assert look() == {"x": 2.0}
    with pytest.raises(ObjectPendingError):
        look("a/other")
    work()
    with pytest.raises(DataError, match="there is no a/other"):
        look("a/other")
