"""The interfaces of a running machine, as its graph tells; and what of them is an order whatever it says."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from rclpy.action import get_action_server_names_and_types_by_node
from rclpy.node import Node

from im_core.errors import ImError
from im_core.ros.messages.interfaces import interface_class, type_name

#: Testbed time is whatever is said there; another clock is no malformed message, but another time.
NOT_TOPICS = {"/clock"}


@dataclass(frozen=True)
class Target:
    """One interface.

    Attributes:
        kind: ``topic``, ``service`` or ``action``.
        name: Its name.
        type: Its class.
    """

    kind: str
    name: str
    type: Any

    @property
    def taken(self) -> type[Any]:
        """Class of what is taken there: the message, the request or the goal."""
        taken: type[Any] = self.type
        if self.kind != "topic":
            taken = self.type.Request if self.kind == "service" else self.type.Goal
        return taken


def targets(node: Node, of: Collection[str]) -> list[Target]:
    """All interfaces that the nodes of these names take something on, sorted."""
    found: dict[tuple[str, str], str] = {}
    for name, namespace in set(node.get_node_names_and_namespaces()):
        if name not in of:
            continue
        actions = get_action_server_names_and_types_by_node(node, name, namespace)
        for kind, told in (
            ("topic", node.get_subscriber_names_and_types_by_node(name, namespace)),
            ("service", node.get_service_names_and_types_by_node(name, namespace)),
            ("action", actions),
        ):
            found |= {(kind, each): types[0] for each, types in told if "/_" not in each}
    return [target for (kind, name), told in sorted(found.items()) if (target := _target(kind, name, told)) is not None]


def is_order(target: Target, message: Any) -> bool:
    """Whether a message or a request is right, so that the machine has to do it: that is no fuzz, and would disturb."""
    fields = message.get_fields_and_field_types()
    if not fields or set(fields) == {"structure_needs_at_least_one_member"}:
        return True
    match type_name(target.type):
        case "im_msgs/srv/CalibrateCamera":
            return not message.cameras and not message.poses_file
        case "trajectory_msgs/msg/JointTrajectory":  # an empty one stops the group, whoever owns it
            return not message.points
        case "im_msgs/srv/GroupCommand":  # anyone may pause all groups
            return not message.group
    return False


def _target(kind: str, name: str, told: str) -> Target | None:
    if name in NOT_TOPICS:
        return None
    try:
        return Target(kind, name, interface_class(told))
    except ImError:  # a type that is not installed here
        return None
