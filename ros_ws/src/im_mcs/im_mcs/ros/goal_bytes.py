"""Goals of an action as the bytes that travel: rclpy hands over topics and services so only where they are topics.

To make objects of a message of 100,000 points takes rclpy seconds, in which no thread of the node runs. What follows
hooks in where rclpy asks a generated class to convert: a class whose conversion encodes the message again (a hundredth
of the time), or notes that it is too long. It relies on the four capsules that rosidl gives every generated class.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.type_support import check_for_type_support
from unique_identifier_msgs.msg import UUID

from im_mcs.client.wire import UUID_BYTES


@dataclass(frozen=True)
class GoalBytes:
    """What a client asked for.

    Attributes:
        data: The request for the goal, in CDR; empty if it is too long.
        points: How many points its trajectory has.
    """

    data: bytes
    points: int


class _Sequence(ctypes.Structure):
    """As rosidl has sequences and texts."""

    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))


class _Head(ctypes.Structure):
    """How a request for a goal with a trajectory begins, in C."""

    _fields_ = (
        ("goal_id", ctypes.c_uint8 * UUID_BYTES),
        ("stamp_s", ctypes.c_int32),
        ("stamp_ns", ctypes.c_uint32),
        ("frame_id", _Sequence),
        ("joint_names", _Sequence),
        ("points", _Sequence),
    )


@dataclass(frozen=True)
class _Request:
    """What rclpy's action server takes for the request."""

    goal_id: UUID
    goal: GoalBytes


_CONVERT = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
_CREATE = ctypes.PYFUNCTYPE(ctypes.c_void_p)
_FILL = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)
_DESTROY = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)


def with_goals_as_bytes(action: Any, most_points: Callable[[], int]) -> Any:
    """The action ``FollowJointTrajectory``, for an action server; its goals are :class:`GoalBytes`.

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
        return _Request(UUID(uuid=list(head.goal_id)), GoalBytes(data, points))

    taking = type("BytesMetaclass", (kind,), {"_CONVERT_TO_PY": _capsule(_CONVERT(convert))})
    service = type("SendGoalService", (action.Impl.SendGoalService,), {"Request": taking("Request", (), {})})
    return type(action)("GoalsAsBytes", (action,), {"Impl": type("Impl", (action.Impl,), {"SendGoalService": service})})


def _encoder(kind: Any) -> Callable[[int], bytes]:
    """A function that encodes the message of a type at an address in memory.

    rclpy encodes objects, which it has their class write into a message in C first; here that message is there already.
    """
    here: list[int] = [0]
    giving = type(
        "GivenMetaclass",
        (type,),
        {
            "_TYPE_SUPPORT": kind._TYPE_SUPPORT,
            "_CREATE_ROS_MESSAGE": _capsule(_CREATE(lambda: here[0])),
            "_CONVERT_FROM_PY": _capsule(_FILL(lambda _, __: True)),
            "_DESTROY_ROS_MESSAGE": _capsule(_DESTROY(lambda _: None)),
        },
    )
    given: Any = giving("Given", (), {})

    def encode(address: int) -> bytes:
        here[0] = address
        return bytes(_rclpy.rclpy_serialize(given(), given))

    return encode


_functions: list[Any] = []
"""Functions whose address a capsule holds; they live as long as the process."""


def _capsule(function: Any) -> Any:
    make = ctypes.pythonapi.PyCapsule_New
    make.restype, make.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    _functions.append(function)
    return make(ctypes.cast(function, ctypes.c_void_p), None, None)
