"""The page of interfaces is made whatever else is in the graph: a recorder answers nothing."""

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from im_bringup.ros import interfaces
from im_bringup.ros.interruptible import InterruptibleNode
from im_core.ros.node import ManagedNode


@pytest.fixture
def recorder(ros):
    """A node without services for its parameters, which nobody spins."""
    node = Node("recorder", enable_rosout=False, start_parameter_services=False)
    yield node
    node.destroy_node()


def test_who_answers_nothing_is_not_waited_for(ros, recorder, wait_until, monkeypatch):
    monkeypatch.setattr(interfaces, "CALL_S", 20.0)
    oven = ManagedNode("oven", parameter_overrides=[Parameter("standalone", value=True)])
    asking = InterruptibleNode("asking")
    oven.create_service(Trigger, "/oven/bake", lambda request, response: response)
    ros(oven, asking)
    wait_until(lambda: {"oven", "recorder"} <= set(asking.get_node_names()), "the nodes")
    interfaces.settle(asking)
    page = interfaces.tables(asking)
    assert "| `/oven/bake` | `std_srvs/srv/Trigger` | `/oven` |" in page
    assert "| `standalone` | bool |  | at the start |" in page


def test_who_is_named_and_has_gone_is_passed_over(ros, monkeypatch):
    """The graph names nodes that have ended: for a while, under load for good."""
    asking = ros(InterruptibleNode("asking"))
    named = asking.get_node_names_and_namespaces
    monkeypatch.setattr(asking, "get_node_names_and_namespaces", lambda: [("gone", "/"), *named()])
    page = interfaces.tables(asking)
    assert "/gone" not in page
