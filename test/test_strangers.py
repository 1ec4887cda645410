"""Messages that any participant of DDS can make up end, fail and restart nothing of the machine."""

import subprocess
import sys
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_srvs.srv import Trigger

from im_bringup.machine import machine_state as machine
from im_bringup.ros import shared_names
from im_core import clock
from im_core.errors import StateError
from im_core.names import run_dir
from im_core.ros import qos
from im_core.ros.messages.status import status_to_error
from im_core.ros.node import ManagedNode
from im_core.ros.peers.client_identity import UNKNOWN_NODE
from im_core.ros.peers.servers import doubt, doubted, reason
from im_msgs.msg import Status, TaskRegistry

#: Publishes what would end the tasks, fail them, or have them count as begun anew: of all that are told of.
STRANGER = """
import rclpy, sys, time
from rclpy.node import Node
from std_msgs.msg import UInt8
from im_core.ros import qos
from im_msgs.msg import TaskRegistry, TaskStatus

rclpy.init()
node = Node("stranger")
phases = node.create_publisher(UInt8, "/im/phase", qos.LATCHED)
statuses = node.create_publisher(TaskStatus, "/im/task_status", qos.STATUS)
heard = {}

def hear(message):
    if message.detail != "made up":
        heard[message.name] = message

node.create_subscription(TaskStatus, "/im/task_status", hear, qos.STATUS)
print("begun", flush=True)
end, numbers = None, iter(range(10**9))
while end is None or time.monotonic() < end:
    listened = time.monotonic() + 0.7  # its own messages come back to it, and more of them than its queue holds
    while time.monotonic() < listened:
        rclpy.spin_once(node, timeout_sec=0.05)
    if end is None and len(heard) == 2:
        end = time.monotonic() + float(sys.argv[1])
    for phase in (3, 0):
        phases.publish(UInt8(data=phase))
    for told in list(heard.values()):
        for phase in range(5):
            for incarnation in (told.incarnation, 1):
                for pid in (told.pid, 1):
                    made_up = dict(name=told.name, host=told.host, pid=pid, incarnation=incarnation, phase=phase)
                    statuses.publish(TaskStatus(detail="made up", **made_up))
    statuses.publish(TaskStatus(detail="made up", name=f"name{next(numbers)}", phase=2))
print(f"heard {len(heard)}", flush=True)
"""


@pytest.fixture
def stranger():
    """Run the stranger for some seconds from when it has heard both tasks."""
    begun = []

    def run(seconds):
        command = [sys.executable, "-c", STRANGER, str(seconds)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        begun.append(process)
        assert process.stdout.readline() == "begun\n"
        return process

    yield run
    for process in begun:
        process.kill()
        process.communicate()


@pytest.fixture
def observer(ros):
    """A node that keeps the registries of the bootstrap."""
    node = Node("observer")
    node.registries = []
    node.create_subscription(TaskRegistry, "/bootstrap/tasks", node.registries.append, qos.LATCHED)
    return ros(node)


def test_no_message_of_a_stranger_ends_fails_or_restarts_a_task(
    script, small_deployment, stranger, observer, wait_until
):
    early = stranger(3600.0)  # also while the machine starts
    done = script("start", small_deployment)
    try:
        assert done.returncode == 0, done.stderr
        early.kill()
        tasks = lambda: observer.registries[-1].tasks if observer.registries else []  # noqa: E731
        wait_until(lambda: [task.phase for task in tasks()] == ["ready", "ready"], "the registry")
        before = [(task.pid, task.incarnation) for task in tasks()]
        other = stranger(8.0)
        told, _ = other.communicate(timeout=300.0)
        assert told == "heard 2\n", "the stranger has not heard the tasks, and so has made up nothing of them"
        last = tasks()
        assert [(task.pid, task.incarnation) for task in last] == before
        assert {(task.phase, task.restarts, "made up" in task.detail) for task in last} == {("ready", 0, False)}
        assert machine.read().state == machine.READY
        assert "made up" not in (run_dir() / "log" / "bootstrap.log").read_text()
    finally:
        down = script("stop")
    assert down.stdout.startswith("stop: all tasks ended in order"), down.stderr


@pytest.fixture
def doubles(ros):
    """Two nodes that serve one name, and answer that nothing works, without a reason."""
    nodes = [ManagedNode(name) for name in ("oven", "impostor")]
    for node in nodes:
        node.create_service(Trigger, "/oven/heat", lambda _, response: response)
    asker = ManagedNode("asker")
    ros(*nodes, asker)
    return asker


def test_a_failure_names_all_who_may_have_answered(doubles, wait_until):
    expected = "the answering node is unknown: 2 nodes serve /oven/heat: /impostor, /oven"
    wait_until(lambda: doubt(doubles, "/oven/heat") == expected, "both servers in the graph")
    assert reason(doubles, "", "/oven/heat") == f"the server of /oven/heat gave no reason; {expected}"
    error = doubted(doubles, StateError("no gas"), "/oven/heat")
    assert (error.code, error.message) == (StateError.default_code, f"no gas; {expected}")
    assert doubt(doubles, "/oven/get_parameters") == ""
    alone = StateError("no gas")
    assert doubted(doubles, alone, "/oven/get_parameters") is alone
    assert status_to_error(Status()).message == "it failed (error), and no reason was given"


def test_a_second_server_of_a_name_of_the_machine_is_told_of(doubles, wait_until, monkeypatch):
    time, told = [100.0], []
    monkeypatch.setattr(shared_names, "clock", SimpleNamespace(monotonic=lambda: time[0], wall=clock.wall))
    names = shared_names.SharedNames(doubles, ["/oven", "/asker"])
    names._publisher = SimpleNamespace(publish=told.append)
    wait_until(names.look, "the second server in the graph")
    sentence = "2 nodes serve /oven/heat: /impostor, /oven; which of them answers is chance"
    assert names.sentences == {"/oven": sentence}
    assert not names.look()
    assert [(each.status[0].level, each.status[0].message) for each in told] == [(DiagnosticStatus.WARN, sentence)] * 2
    monkeypatch.setattr(shared_names, "servers_of", lambda *_: ["/oven", f"/{UNKNOWN_NODE}"])
    assert names.look()
    monkeypatch.setattr(shared_names, "servers_of", lambda *_: ["/oven", "/oven"])
    assert not names.look()
    assert names.sentences == {}
    assert told[-1].status[0].level == DiagnosticStatus.OK
    time[0] += 29.0  # one of them may be dead
    assert not names.look()
    time[0] += 2.0
    assert names.look()
    assert names.sentences["/oven"].startswith("2 nodes serve /oven/heat: /oven, /oven; ")
