"""Names and types of ROS in nets: one type a name, another one after a reload, and what the middleware refuses."""

import pytest
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from im_core.errors import ImError
from im_core.ros.node import ManagedNode
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode

ALONE = [Parameter("standalone", value=True)]
RING = """
net: ring
places: {idle: 1, rung: , bad: }
transitions:
  ring: {symbol: ring, in: idle, out: rung, on_failure: bad, ACTION}
  tell: {in: rung, out: idle, emit: ring_done}
  give_up: {in: bad, out: idle, emit: ring_failed}
"""
SERVICE = "service: {name: /bell, type: std_srvs/srv/TYPE}"
KINDS = {
    "service": (SERVICE, "SetBool", "Trigger"),
    "goal": ("goal: {name: /bell, type: TYPE}", "control_msgs/action/GripperCommand", "im_msgs/action/Move"),
    "topic": ("topic: {name: /bell, type: std_msgs/msg/TYPE}", "String", "Empty"),
    "await": ("await: {name: /bell, type: std_msgs/msg/TYPE}", "String", "Empty"),
}


class Bell(ManagedNode):
    """A bell that rings."""

    def __init__(self) -> None:
        super().__init__("bell", parameter_overrides=ALONE)
        self.create_service(Trigger, "/bell", lambda request, response: Trigger.Response(success=True))


def ring(kind: str, of_type: str) -> str:
    return RING.replace("ACTION", KINDS[kind][0].replace("TYPE", of_type))


@pytest.fixture
def ringer(tmp_path, ros, wait_until):
    """``ringer(text)``: a node with this net; ``node.load(text)`` returns why another one is refused, or nothing."""

    def make(text):
        (tmp_path / "ring.yaml").write_text(text)
        node = PntNode("ringer", [tmp_path / "ring.yaml"], verifier=verify_to_load, parameter_overrides=ALONE)

        def load(text):
            said = []

            async def work():
                try:
                    await node.load_net(parse_net(text), 60.0)
                except ImError as error:
                    said.append(error.message)
                else:
                    said.append("")

            node.spawn(work())
            wait_until(lambda: said, "the net to be loaded, or refused")
            return said[0]

        node.load = load
        ros(node)
        wait_until(lambda: node.ready or node.failed, "the node")
        return node

    return make


@pytest.mark.parametrize("kind", KINDS)
def test_a_net_that_is_loaded_anew_may_use_a_name_with_another_type(ringer, kind):
    _, before, after = KINDS[kind]
    node = ringer(ring(kind, before))
    assert node.ready, node.failed
    for of_type in (after, before):
        assert node.load(ring(kind, of_type)) == ""


def test_what_is_called_is_of_the_type_that_the_net_says_now(ringer, ros, wait_until):
    node = ringer(ring("service", "SetBool"))
    assert node.load(ring("service", "Trigger")) == ""
    ros(Bell())
    ended = []

    async def work():
        ended.append(await node.commands.run("ring"))

    node.spawn(work())
    wait_until(lambda: ended, "the bell")
    assert ended[0].success, ended[0].status.message


def test_a_second_type_of_a_name_is_refused_by_both_names(ringer):
    node = ringer(ring("service", "Trigger"))
    chime = ring("service", "SetBool").replace("net: ring", "net: chime").replace("symbol: ring", "symbol: chime")
    refused = node.load(chime.replace("ring_", "chime_"))
    assert "chime.ring says that /bell is of type std_srvs/srv/SetBool, and ring.ring that it is of type" in refused
    assert list(node.exchange.nets) == ["ring"]


def test_a_name_that_the_middleware_does_not_take_is_refused_with_its_sentence(ringer):
    """What stands for the namespace of the node is known to nobody before."""
    node = ringer(ring("service", "Trigger"))
    refused = node.load(ring("service", "Trigger").replace("/bell", "'{ns}/bell'"))
    assert "ring.ring: service {ns}/bell cannot be prepared: " in refused
    assert "must not contain repeated '/'" in refused
