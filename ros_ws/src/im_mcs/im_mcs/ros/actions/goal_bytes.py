"""Action goals as transmitted bytes: rclpy delivers topics and services in bytes, but not actions.

To make objects of a message of 100,000 points takes rclpy seconds, in which no thread of the node runs. What follows
hooks in where rclpy asks a generated class to convert: a class whose conversion encodes the message again (a hundredth
of the time), or notes that it is too long.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.serialization import deserialize_message
from rclpy.type_support import check_for_type_support
from unique_identifier_msgs.msg import UUID

from im_core.ros.conversion import Sequence, capsule, converted_by
from im_mcs.client.wire import UUID_BYTES


@dataclass(frozen=True)
class GoalBytes:
    """Goal of a client.

    Attributes:
        data: The request for the goal, in CDR; empty if it is too long.
        points: How many points its trajectory has.
        kind: Generated class of that request.
    """

    data: bytes
    points: int
    kind: Any

    def request(self) -> Any:
        """Return the request as a message; None if the conversion would take long, or the request is missing."""
        return deserialize_message(self.data, self.kind) if self.data and self.points <= _FEW else None


_FEW = 1000
"""Of so many points objects are made in some ten milliseconds."""


class _Head(ctypes.Structure):
    """How a request for a goal with a trajectory begins, in C."""

    _fields_ = (
        ("goal_id", ctypes.c_uint8 * UUID_BYTES),
        ("stamp_s", ctypes.c_int32),
        ("stamp_ns", ctypes.c_uint32),
        ("frame_id", Sequence),
        ("joint_names", Sequence),
        ("points", Sequence),
    )


@dataclass(frozen=True)
class _Request:
    """Request type for rclpy's action server."""

    goal_id: UUID
    goal: GoalBytes


_CREATE = ctypes.PYFUNCTYPE(ctypes.c_void_p)
_FILL = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)
_DESTROY = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)


def with_goals_as_bytes(action: Any, most_points: Callable[[], int]) -> Any:
    """Return the action ``FollowJointTrajectory`` for a server with goals as :class:`GoalBytes`.

    Args:
        action: The generated class.
        most_points: How many points a goal may have; a longer one is not even encoded.
    """
    check_for_type_support(action)
    kind = type(action.Impl.SendGoalService.Request)
    encode = _encoder(kind)

    def convert(address: int) -> _Request:
        head = ctypes.cast(address, ctypes.POINTER(_Head)).contents
        points = int(head.points.size)
        data = encode(address) if points <= most_points() else b""
        return _Request(UUID(uuid=list(head.goal_id)), GoalBytes(data, points, action.Impl.SendGoalService.Request))

    request = converted_by(action.Impl.SendGoalService.Request, convert)
    service = type("SendGoalService", (action.Impl.SendGoalService,), {"Request": request})
    return type(action)("GoalsAsBytes", (action,), {"Impl": type("Impl", (action.Impl,), {"SendGoalService": service})})


def _encoder(kind: Any) -> Callable[[int], bytes]:
    """Return a function to encode the message of a type at an address in memory.

    rclpy encodes objects, which it has their class write into a message in C first; here that message is there already.
    """
    here: list[int] = [0]
    giving = type(
        "GivenMetaclass",
        (type,),
        {
            "_TYPE_SUPPORT": kind._TYPE_SUPPORT,
            "_CREATE_ROS_MESSAGE": capsule(_CREATE(lambda: here[0])),
            "_CONVERT_FROM_PY": capsule(_FILL(lambda _, __: True)),
            "_DESTROY_ROS_MESSAGE": capsule(_DESTROY(lambda _: None)),
        },
    )
    given: Any = giving("Given", (), {})

    def encode(address: int) -> bytes:
        here[0] = address
        return bytes(_rclpy.rclpy_serialize(given(), given))

    return encode
