"""No process shares memory with others through the middleware, and what begins after a killed one hears all."""

import os
import subprocess
import sys
import threading

import pytest
from std_msgs.msg import Int32

from im_core.ros.node import ManagedNode
from support.whole_machine import segments

LISTENER = """
import rclpy
from std_msgs.msg import Int32
from rclpy.node import Node
from im_core.ros.guard import GuardedNode
rclpy.init()
node = {kind}("listener")
node.create_subscription(Int32, "/told", lambda message: print(message.data, flush=True), 10)
rclpy.spin(node)
"""
CLIENT = """
import threading
from std_msgs.msg import Int32
from im.connection import Connection
Connection().subscribe(Int32, "/told", lambda message: print(message.data, flush=True), 10)
threading.Event().wait()
"""
PATIENCE_S = 60.0


class Listener:
    """A process that prints what it hears; its output is read by a thread."""

    def __init__(self, kind):
        program = CLIENT if kind == "Connection" else LISTENER.format(kind=kind)
        command = [sys.executable, "-c", program]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self._heard = threading.Event()
        self._lines = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self._lines.append(line)
            self._heard.set()

    def require_to_hear(self):
        """Only what was told is printed: nothing of the middleware is."""
        assert self._heard.wait(PATIENCE_S)
        assert set(self._lines) == {"7\n"}

    def kill(self):
        self.process.kill()
        self.process.wait(PATIENCE_S)


@pytest.fixture
def listener(ros):
    """Begins listeners to a node that tells twenty messages a second."""
    teller = ros(ManagedNode("teller"))
    publisher = teller.create_publisher(Int32, "/told", 10)
    teller.create_timer(0.05, lambda: publisher.publish(Int32(data=7)))
    begun = []

    def begin(kind):
        begun.append(Listener(kind))
        return begun[-1]

    yield begin
    for each in begun:
        each.kill()


@pytest.mark.parametrize("kind", ["Node", "GuardedNode", "Connection"])
def test_each_process_that_follows_a_killed_one_hears_and_shares_no_memory(listener, kind):
    for _ in range(3):
        following = listener(kind)
        following.require_to_hear()
        assert segments(following.process.pid) == segments(os.getpid()) == []
        following.kill()


def test_a_process_that_has_shared_memory_hears_too(listener, monkeypatch):
    """As a program of the user's with the default transports of Fast DDS, whatever its range of discovery."""
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE")
    for reach in ("SUBNET", "LOCALHOST"):
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
        following = listener("Node")
        following.require_to_hear()
        assert segments(following.process.pid), reach
