"""The place of a killed process in the middleware is taken by nobody: what begins next hears all that goes on."""

import os
import re
import subprocess
import sys

import pytest

from im_bringup.tasks.dead_ports import DeadPorts
from im_core import clock
from im_core.shm_names import SHM, lock

LISTENER = """
import rclpy
from std_msgs.msg import Int32
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(Int32, "/told", lambda message: print(message.data, flush=True), 10)
rclpy.spin(node)
"""
PATIENCE_S = 60.0


def ports_in_use():
    """Ports of living processes in this ROS domain, in shared memory."""
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
    found = set()
    for path in SHM.glob("fastrtps_port*_el"):
        port = int(re.search(r"\d+", path.name)[0])
        try:
            os.close(lock(path))
        except OSError:
            if first <= port < first + 250:
                found.add(port)
    return found


@pytest.fixture
def told(ros):
    """Tells the time again and again; begins before the listeners."""
    from std_msgs.msg import Int32

    from im_core.ros.node import ManagedNode

    node = ros(ManagedNode("teller"))
    publisher = node.create_publisher(Int32, "/told", 10)
    node.create_timer(0.05, lambda: publisher.publish(Int32(data=7)))


def test_a_process_hears_where_another_was_killed(told):
    ports, seen, before = DeadPorts(int(os.environ["ROS_DOMAIN_ID"])), [], ports_in_use()
    try:
        for _ in range(2):
            listener = subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True)
            try:
                assert listener.stdout.readline() == "7\n"
                seen.append(ports_in_use() - before)
            finally:
                listener.kill()
                listener.wait(PATIENCE_S)
            deadline = clock.monotonic() + PATIENCE_S
            while not ports.hold():
                assert clock.monotonic() < deadline, "no port was left by the killed process"
                clock.sleep(0.05)
            before |= ports_in_use()
        first, second = seen
        assert first
        assert second
        assert not first & second
    finally:
        ports.close()
