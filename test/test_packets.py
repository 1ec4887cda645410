"""What crafted packets do to a node: it ends within its limits, is named, and comes back (docs/security.md)."""

import os
import sys

import pytest
from std_msgs.msg import String

from im_bringup.tasks import receivers
from im_bringup.tasks.agent import Agent, Died, ProcessCommand, Started
from im_core import clock
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from support import rtps

#: A node alone has 200 MiB.
LIMIT_MIB = 400
#: More than a reader counts to within days.
FAR = 2**40
#: The entity of each participant that tells of its publishers (RTPS 9.3.1.3).
DISCOVERY = bytes.fromhex("000003c2")

NODE = '''\
"""A node that writes down what it hears."""
import os, pathlib, sys
from im_core.ros import qos, run
from im_core.ros.node import ManagedNode
from std_msgs.msg import String

FOLDER = pathlib.Path(sys.argv.pop(1))

class Listener(ManagedNode):
    def __init__(self):
        super().__init__("listener")
        self.create_subscription(String, "/listener/said", self.hear, qos.LATCHED)

    def hear(self, message):
        (FOLDER / "heard").write_text(f"{message.data} by {os.getpid()}")

sys.exit(run.main(Listener))
'''


@pytest.fixture
def listener(tmp_path):
    """Its agent, and what tells what it has heard."""
    (tmp_path / "listener.py").write_text(NODE, encoding="utf-8")
    argv = [sys.executable, "-u", str(tmp_path / "listener.py"), str(tmp_path)]
    argv += ["--ros-args", "-p", "standalone:=true"]
    command = ProcessCommand("listener", ("listener",), argv, tmp_path / "listener.log", LIMIT_MIB)
    agent, heard = Agent([command], dict(os.environ)), tmp_path / "heard"
    agent.respawn = True
    yield agent, lambda: heard.read_text() if heard.exists() else ""
    agent.shut_down()


@pytest.fixture
def speaker(ros):
    """A node that publishes what the listener hears."""
    node = ros(ManagedNode("speaker"))
    node.said = node.create_publisher(String, "/listener/said", qos.LATCHED)
    return node


def polled(agent, events):
    events += agent.poll(clock.monotonic())
    return events


def attack(listener, speaker, wait_until, packet):
    """Send a packet in the name of the speaker; how the listener ended, and a check that the next one hears."""
    (agent, heard), events = listener, []
    [started] = agent.start()
    speaker.said.publish(String(data="before"))
    wait_until(lambda: heard() == f"before by {started.pid}", "the listener")
    [end] = speaker.get_publishers_info_by_topic("/listener/said")
    rtps.send(packet(bytes(end.endpoint_gid[:16])), started.pid)
    wait_until(lambda: len(polled(agent, events)) >= 2, "the death and the new start")
    died, again = events
    assert isinstance(died, Died)
    assert isinstance(again, Started)
    speaker.said.publish(String(data="after"))
    wait_until(lambda: heard() == f"after by {again.pid}", "the new listener")
    return died.sentence


@pytest.mark.parametrize(
    "packet",
    [
        lambda writer: rtps.gap(writer, 1000, FAR),
        lambda writer: rtps.gap(writer[:12] + DISCOVERY, 1000, FAR),
        lambda writer: rtps.data_frag(writer, 50, 2**32 - 16),
    ],
    ids=["gap", "gap_in_discovery", "fragment"],
)
def test_a_packet_takes_no_more_memory_than_the_limit(listener, speaker, wait_until, packet):
    told = attack(listener, speaker, wait_until, packet)
    assert f"more memory than its limit of {LIMIT_MIB} MiB" in told or f"its limit is {LIMIT_MIB} MiB" in told


@pytest.mark.parametrize(
    "packet",
    [lambda writer: rtps.gap(writer, 1, FAR), lambda writer: rtps.heartbeat(writer, FAR, FAR)],
    ids=["gap", "heartbeat"],
)
def test_a_node_in_which_a_packet_never_ends_is_started_again(listener, speaker, monkeypatch, wait_until, packet):
    monkeypatch.setattr(receivers, "STUCK_S", 1.0)
    told = attack(listener, speaker, wait_until, packet)
    assert "it failed: its thread dds.udp." in told
    assert "in one packet" in told
