"""``scripts/im recover`` at ``/mcs``: whatever state it was left in, it is cold again and tells why it was not."""

import os
import signal

import pytest

from im_bringup.ros.recover import RecoverClient
from im_cell.link import PanelEnd
from im_core import names
from im_core.ros import qos
from im_core.ros.run import spin_in_thread
from im_msgs.msg import TaskRecord, TaskRegistry


@pytest.fixture
def recover(client):
    """Runs the command; what it came to, and what it said. A registry says that the tasks are ready."""
    publisher = client.node.create_publisher(TaskRegistry, "/bootstrap/tasks", qos.LATCHED)
    publisher.publish(TaskRegistry(tasks=[TaskRecord(name="mcs", phase="ready", pid=os.getpid())]))

    def run():
        told = []
        with spin_in_thread(node := RecoverClient(told.append)):
            return node.recover(30.0), told

    yield run
    client.node.destroy_publisher(publisher)


def test_a_machine_that_is_well_is_left_alone(client, recover):
    client.to_motion()
    assert recover() == ("ready: 1 tasks, MCS is motion", [])


def test_after_an_emergency_stop(client, recover):
    client.to_motion()
    assert client.trigger("estop").success
    client.until(lambda: client.state() == "estopped")
    assert "(scripts/im recover does it)" in client.trigger("power_on").message
    summary, told = recover()
    assert summary == "ready: 1 tasks, MCS is cold"
    assert told == ["MCS is estopped: request on /mcs/estop; reset"]


def test_after_the_death_of_the_servo(client, recover):
    with PanelEnd.attach(names.instance(), 1.0) as panel:
        os.kill(panel.servo_pid, signal.SIGKILL)
    client.until(lambda: client.state() == "unconfigured")
    assert client.states[-1].reason == "the process im_mcs.servo ended with code -9"
    summary, told = recover()
    assert summary == "ready: 1 tasks, MCS is cold"
    assert told == ["MCS is unconfigured: the process im_mcs.servo ended with code -9; configure"]
    client.until(lambda: client.state() == "cold")
    assert client.states[-1].reason == ""  # an older crash is not told of a living servo
    assert client.change("cleanup")
    client.until(lambda: client.state() == "unconfigured")
    assert client.states[-1].reason == ""
    assert "ended with code" not in client.trigger("power_on").message
