"""Caller of a request: the process behind a request of a service or an action.

Every request of DDS carries the identity of its writer, whose first twelve bytes are those of the participant: a
context of ROS, in nearly all cases a process. ``rclpy`` keeps it, but shows the sequence number only; it is read here
from the memory of the header, and believed only if the sequence number beside it is the one that ``rclpy`` shows.

The graph tells which nodes a participant has: each of them publishes :data:`TOPICS_OF_ALL`.
"""

import ctypes
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node

from im_core.ros.peers.servers import node_of

TOPICS_OF_ALL = ("/rosout", "/parameter_events")
"""Topics that a node publishes whatever else it does, unless it is told not to."""

_POINTER_AT = 16
"""Where an object of pybind11 keeps the address of its value: after the head that every Python object has [bytes]."""
_PARTICIPANT_BYTES = 12
UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"


class _RequestId(ctypes.Structure):
    """``rmw_request_id_t``."""

    _fields_ = (("writer_guid", ctypes.c_uint8 * 16), ("sequence_number", ctypes.c_int64))


class _ServiceInfo(ctypes.Structure):
    """``rmw_service_info_t``."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("request_id", _RequestId),
    )


def client_of(header: Any) -> str:
    """Return the process of a request's sender, as a text equal for all requests of the process; empty if unknown.

    Args:
        header: As taken with the request: ``rmw_service_info_t`` or ``rmw_request_id_t``.
    """
    return process_of(sender_of(header))


def sender_of(header: Any) -> str:
    """Return the ROS client of a request's sender, as :func:`client_of`; a process may have several of one service."""
    if isinstance(header, _rclpy.rmw_service_info_t):
        request, shown = _value(_ServiceInfo, header).request_id, header.request_id.sequence_number
    elif isinstance(header, _rclpy.rmw_request_id_t):
        request, shown = _value(_RequestId, header), header.sequence_number
    else:
        raise TypeError(f"a {type(header).__name__} is not the header of a request")
    return bytes(request.writer_guid).hex() if request.sequence_number == shown else ""


def process_of(sender: str) -> str:
    """The process of a sender, as :func:`client_of` says."""
    return sender[: 2 * _PARTICIPANT_BYTES]


def nodes_of(node: Node, client: str) -> tuple[str, ...]:
    """Names of a process's nodes, ``/namespace/name`` each; empty if none is known, or not yet."""
    ends = [end for topic in TOPICS_OF_ALL for end in node.get_publishers_info_by_topic(topic)]
    mine = [end for end in ends if bytes(end.endpoint_gid[:_PARTICIPANT_BYTES]).hex() == client]
    names = {node_of(end) for end in mine if end.node_name != UNKNOWN_NODE}
    return tuple(sorted(names))


def _value(kind: Any, header: Any) -> Any:
    """The structure of C behind an object of pybind11."""
    return kind.from_address(ctypes.c_void_p.from_address(id(header) + _POINTER_AT).value)
