"""The bridge to Foxglove, as a plain websocket client of ``foxglove.sdk.v1`` sees it."""

import asyncio
import json
import socket
import struct

import aiohttp
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from im_bag.ros.foxglove_bridge import FoxgloveBridge

JOINTS = JointState(name=["left_j1"], position=[0.25])
URDF = String(data="<robot name='cell'/>")
WAIT_S = 60.0


class Cell(Node):
    """Publishes as the machine does: a stream, and a description that is latched."""

    def __init__(self):
        super().__init__("cell")
        self.joints = self.create_publisher(JointState, "/joint_states", 10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_publisher(String, "/robot_description", latched).publish(URDF)
        self.create_timer(0.02, lambda: self.joints.publish(JOINTS))


@pytest.fixture
def port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture
def cell(ros):
    return ros(Cell())


@pytest.fixture
def bridge(ros, cell, port, wait_until):
    given = {"standalone": True, "port": port}
    node = ros(FoxgloveBridge(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()]))
    wait_until(lambda: node.ready or node.failed, "the bridge")
    assert node.ready, node.failed
    yield node
    node.phase_shutdown()


class Viewer:
    """Client of the bridge; topics with their channels, and messages as they come."""

    def __init__(self, socket):
        self._socket, self.channels = socket, {}

    async def hear(self):
        """The next message: its topic and its bytes; None if the channels have changed."""
        message = await asyncio.wait_for(self._socket.receive(), WAIT_S)
        if message.type is aiohttp.WSMsgType.BINARY:
            kind, subscription, _ = struct.unpack_from("<BIQ", message.data)
            assert kind == 1
            return next(topic for topic, each in self.channels.items() if each["id"] == subscription), message.data[13:]
        told = json.loads(message.data)
        self.channels.update({each["topic"]: each for each in told.get("channels", ())})
        for gone in told.get("channelIds", ()):
            self.channels = {topic: each for topic, each in self.channels.items() if each["id"] != gone}
        return None

    async def offered(self, topic, there=True):
        while (topic in self.channels) is not there:
            await self.hear()
        return self.channels.get(topic)

    async def open(self, topic):
        number = (await self.offered(topic))["id"]
        await self._socket.send_json({"op": "subscribe", "subscriptions": [{"id": number, "channelId": number}]})

    async def close(self, topic):
        await self._socket.send_json({"op": "unsubscribe", "subscriptionIds": [self.channels[topic]["id"]]})

    async def message(self, topic, kind):
        while (heard := await self.hear()) is None or heard[0] != topic:
            pass
        return deserialize_message(heard[1], kind)


def view(port, *works):
    """Have clients of the bridge work, all at once."""

    async def client(http, work):
        async with http.ws_connect(f"ws://127.0.0.1:{port}", protocols=["foxglove.sdk.v1"]) as socket:
            assert socket.protocol == "foxglove.sdk.v1"
            await work(Viewer(socket))

    async def all_at_once():
        async with aiohttp.ClientSession() as http:
            await asyncio.gather(*(client(http, work) for work in works))

    asyncio.run(all_at_once())


def test_joint_states_are_offered_with_their_definition_and_shown(bridge, port):
    async def work(viewer):
        channel = await viewer.offered("/joint_states")
        assert (channel["encoding"], channel["schemaName"], channel["schemaEncoding"]) == (
            "cdr",
            "sensor_msgs/msg/JointState",
            "ros2msg",
        )
        assert "float64[] position" in channel["schema"]
        assert "MSG: builtin_interfaces/Time" in channel["schema"]
        await viewer.open("/joint_states")
        assert await viewer.message("/joint_states", JointState) == JOINTS

    view(port, work)


def test_the_bridge_hears_what_a_viewer_has_open_and_nothing_else(bridge, cell, port, wait_until):
    def heard():
        return [topic for topic in ("/joint_states", "/robot_description") if cell.count_subscribers(topic)]

    async def work(viewer):
        await viewer.offered("/joint_states")
        assert heard() == []
        await viewer.open("/joint_states")
        await viewer.message("/joint_states", JointState)
        assert heard() == ["/joint_states"]
        await viewer.close("/joint_states")
        while heard():
            await asyncio.sleep(0.05)
        await viewer.open("/joint_states")
        await viewer.message("/joint_states", JointState)

    view(port, work)
    wait_until(lambda: not heard(), "the end of the subscription of a viewer that has gone")


def test_what_is_latched_reaches_a_viewer_who_comes_later(bridge, port):
    first_has_it = asyncio.Event()

    async def first(viewer):
        await viewer.open("/robot_description")
        assert await viewer.message("/robot_description", String) == URDF
        first_has_it.set()

    async def second(viewer):
        await first_has_it.wait()
        await viewer.open("/robot_description")
        assert await viewer.message("/robot_description", String) == URDF

    view(port, first, second)


def test_topics_come_and_go(bridge, cell, port):
    async def work(viewer):
        late = cell.create_publisher(String, "/late", 10)
        await viewer.offered("/late")
        cell.destroy_publisher(late)
        await viewer.offered("/late", there=False)

    view(port, work)


def test_a_port_in_use_is_named(ros, bridge, port, wait_until):
    given = {"standalone": True, "port": port}
    other = FoxgloveBridge(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    ros(other)
    wait_until(lambda: other.failed, "the failure")
    assert f"Foxglove cannot be served on 127.0.0.1:{port}: " in other.failed
    assert "in use" in other.failed
