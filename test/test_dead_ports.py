"""The place of a killed process in the middleware is taken by nobody: what begins next hears all that goes on."""

import contextlib
import os
import signal
import subprocess
import sys
import threading

import pytest
from std_msgs.msg import Int32

from im_core import dead_ports
from im_core.ros.node import ManagedNode
from im_core.shm_names import SHM, lock

LISTENER = """
import rclpy
from rclpy.node import Node
from std_msgs.msg import Int32
from im_core.ros.guard import GuardedNode
rclpy.init()
node = {kind}("listener")
node.create_subscription(Int32, "/told", lambda message: print(message.data, flush=True), 10)
print("begun", flush=True)
rclpy.spin(node)
"""
CLIENT = """
import threading
from std_msgs.msg import Int32
from im.connection import Connection
Connection().subscribe(Int32, "/told", lambda message: print(message.data, flush=True), 10)
print("begun", flush=True)
threading.Event().wait()
"""
PATIENCE_S = 60.0
#: How long no message may come, of twenty a second, until a listener counts as deaf [s].
SILENCE_S = 6.0
#: ``PortNode`` of Fast DDS 2.14: 1024 states of readers of 20 bytes, and the name of the shared memory.
READERS, STATE_SIZE, NAME = 1024, 20, b"fastrtps\0"
IN_USE, WAITS, IS_BUSY = 1, 2, 4


class Listener:
    """A process that prints what it hears; its output is read by a thread."""

    def __init__(self, kind):
        program = CLIENT if kind == "Connection" else LISTENER.format(kind=kind)
        command = [sys.executable, "-c", program]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.told_first = []
        for line in self.process.stdout:
            if line == "begun\n":
                break
            self.told_first.append(line)
        assert self.process.poll() is None, self.told_first
        self._heard = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for _ in self.process.stdout:
            self._heard.set()

    def hears(self, seconds=PATIENCE_S):
        return self._heard.wait(seconds)

    def kill(self, between_messages=False):
        """Ends it with SIGKILL; at will where its readers have told one message and do not wait for the next one."""
        os.kill(self.process.pid, signal.SIGSTOP)
        if between_messages:
            for port in self.ports():
                with (SHM / port).open("r+b") as file:
                    states = file.read().find(NAME) - READERS * STATE_SIZE
                    file.seek(states)
                    before = file.read(1)[0]
                    assert before & IN_USE
                    file.seek(states)
                    file.write(bytes([before & ~(WAITS | IS_BUSY)]))
        self.process.kill()
        self.process.wait(PATIENCE_S)

    def ports(self):
        """The ports that it has locked."""
        for descriptor in os.listdir(f"/proc/{self.process.pid}/fd"):
            with contextlib.suppress(OSError):
                path = os.readlink(f"/proc/{self.process.pid}/fd/{descriptor}")
                if path.startswith(f"{SHM}/fastrtps_port") and path.endswith("_el"):
                    yield path.removeprefix(f"{SHM}/").removesuffix("_el")


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
        each.process.kill()
        each.process.wait(PATIENCE_S)


@pytest.fixture
def deadly(listener):
    """A listener killed at the moment that leaves the next one at its port deaf."""
    first = listener("Node")
    assert first.hears()
    first.kill(between_messages=True)


@pytest.fixture
def without_renewal(monkeypatch):
    """What Fast DDS does by itself."""
    monkeypatch.setattr(dead_ports, "renew_ports", lambda: None)


def test_fast_dds_still_leaves_the_next_process_deaf(without_renewal, listener, deadly):
    """Another test may hold the dead port for a moment, which the next process then passes over."""
    for _ in range(6):
        following = listener("Node")
        if not following.hears(SILENCE_S):
            return
        following.kill(between_messages=True)
    pytest.fail("each process heard: Fast DDS may be mended")


@pytest.fixture
def renewed_soon(monkeypatch):
    """Nodes that look for removed ports twice a second."""
    monkeypatch.setattr(dead_ports, "RENEWAL_S", 0.5)


def test_a_node_finds_a_listener_in_bare_rclpy_that_took_a_dead_port(renewed_soon, listener, deadly):
    for _ in range(4):
        following = listener("Node")
        assert following.hears()
        following.kill(between_messages=True)


@pytest.mark.parametrize(("kind", "times"), [("GuardedNode", 1), ("GuardedNode", 3), ("Connection", 2)])
def test_the_next_node_hears(listener, deadly, kind, times):
    for _ in range(times):
        following = listener(kind)
        assert following.hears()
        following.kill(between_messages=True)


def test_a_port_removed_while_a_process_writes_there_is_taken_without_a_word(listener):
    first = listener("GuardedNode")
    assert first.hears()
    ports = list(first.ports())
    assert ports
    first.kill()
    for port in ports:
        (SHM / port).unlink()
        (SHM / f"{port}_el").unlink()
    assert listener("GuardedNode").told_first == []


@pytest.fixture
def unfinished():
    """The ports of the domain that no process reads, as one leaves them that was killed while it made them."""
    first, made = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"]), []  # as RTPS says
    for number in range(first, first + 60):
        port, held = SHM / f"fastrtps_port{number}", SHM / f"fastrtps_port{number}_el"
        with contextlib.suppress(BlockingIOError):  # read by a process
            with contextlib.suppress(FileNotFoundError):
                os.close(lock(held))
                held.unlink()
            port.unlink(missing_ok=True)  # it may be in memory
            port.touch()
            os.utime(port, (0.0, 0.0))
            made.append(port)
    yield
    for port in made:
        port.unlink(missing_ok=True)


@pytest.mark.parametrize("kind", ["GuardedNode", "Connection"])
def test_a_process_begins_where_the_maker_of_its_port_was_killed(unfinished, kind):
    Listener(kind).kill()
