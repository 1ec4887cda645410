"""What DDS holds of large messages is given back: the profile of the machine keeps no buffers of their size."""

import ctypes
import sys

from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from std_msgs.msg import String

from im_core.ros import qos
from im_core.ros.calls import call_blocking

LARGE = 4_000_000
#: Nodes of another process, with clients for all that the node of the test serves, until it is ended.
CROWD = """
import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

rclpy.init(args=[])
nodes = [Node(f"crowd_{number}") for number in range(10)]
clients = [node.create_client(GetParameters, f"/visited/serve_{rank}") for node in nodes for rank in range(30)]
while not all(client.wait_for_service(timeout_sec=1.0) for client in clients):
    pass
print("all met", flush=True)
rclpy.spin(nodes[0])
"""


class MallocInfo(ctypes.Structure):
    """``struct mallinfo2`` of glibc."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost",
        )
    )  # fmt: skip


def allocated():
    """What this process has allocated and not freed, whether or not the kernel has it back [bytes]."""
    libc = ctypes.CDLL(None)
    libc.mallinfo2.restype = MallocInfo
    info = libc.mallinfo2()
    return info.uordblks + info.hblkhd


def test_what_large_messages_took_is_given_back(ros, wait_until):
    node, other, heard = Node("flooded"), Node("flooding"), []
    node.create_service(GetParameters, "/flooded/take", lambda request, response: response)
    node.create_subscription(String, "/flooded/hear", lambda message: heard.append(len(message.data)), qos.EVENTS)
    client = other.create_client(GetParameters, "/flooded/take")
    publisher = other.create_publisher(String, "/flooded/hear", qos.EVENTS)
    ros(node, other)
    wait_until(lambda: client.service_is_ready() and publisher.get_subscription_count(), "the other node")

    def flood(length):
        for _ in range(3):
            call_blocking(client, GetParameters.Request(names=["x" * length]), 60.0, "/flooded/take")
        publisher.publish(String(data="x" * length))
        wait_until(lambda: heard and heard[-1] == length, "the message")

    flood(1)
    before = allocated()
    flood(LARGE)
    flood(2)  # a history of one message holds the last
    assert allocated() - before < LARGE / 2


def test_what_a_crowd_took_serves_the_next_one(ros, process, wait_until):
    """Fast DDS keeps what it allocated for ends of others when they go: as many as there were at once, not in all."""
    node, served = ros(Node("visited")), [f"/visited/serve_{rank}" for rank in range(30)]
    for name in served:
        node.create_service(GetParameters, name, lambda request, response: response)

    def clients():
        return [node.count_clients(name) for name in served]

    taken = [allocated()]
    for _ in range(3):
        crowd = process(sys.executable, "-c", CROWD)
        wait_until(lambda each=crowd: "all met" in each.out.read_text(), "the crowd")
        wait_until(lambda: clients() == [10] * len(served), "its clients")
        crowd.send_signal(2)
        crowd.wait()
        wait_until(lambda: not any(clients()), "its end")  # the graph may go on naming nodes that are gone
        taken.append(allocated())
    first = taken[1] - taken[0]
    assert max(taken[2:]) - taken[1] < first / 4
