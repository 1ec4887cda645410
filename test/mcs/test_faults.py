"""What ends a motion, or MCS: e-stop, cancel, cleanup, processes that are killed."""

import os
import signal
import sys
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from im_cell.link import PanelEnd, ServoEnd
from im_core import names
from im_msgs.srv import GetGroupState, ReserveGroup

UNCONFIGURED = "MCS is unconfigured; scripts/im recover configures it (transition configure on /mcs/change_state)"


def test_unconfigured(client):
    assert client.change("cleanup")
    assert client.lifecycle() == "unconfigured"
    assert client.trigger("power_on").message == UNCONFIGURED
    assert client.call(ReserveGroup, "reserve", group="left").message == UNCONFIGURED
    assert client.call(GetGroupState, "get_group_state", group="left").status.message == UNCONFIGURED
    assert client.move(client.home).status.message == UNCONFIGURED
    assert client.change("configure")
    assert client.lifecycle() == "inactive"
    client.call(ReserveGroup, "reserve", group="left")
    diagnostics = client.listen(DiagnosticArray, "/diagnostics")
    assert not client.change("cleanup")  # refused: a group is reserved
    failure = "the lifecycle transition cleanup failed: cleanup is refused in state reserved; allowed here: "
    client.until(lambda: lifecycle_diagnosis(diagnostics).message.startswith(failure))
    assert lifecycle_diagnosis(diagnostics).level == DiagnosticStatus.WARN
    assert client.change("activate")
    client.until(lambda: client.state() == "active")
    client.until(lambda: lifecycle_diagnosis(diagnostics).message == "active")
    assert client.change("deactivate")
    client.until(lambda: client.state() == "reserved")


def test_a_servo_that_is_killed_while_it_writes_is_noticed(client):
    client.to_motion()
    torn = client.mcs._mcs.keeper.client()._channel.snapshot
    with PanelEnd.attach(names.instance(), 60.0) as panel:
        pid = panel.servo_pid
    os.kill(pid, signal.SIGSTOP)
    torn._sequence[()] |= 1
    assert "the stop circuit of testbed is cut" in client.trigger("estop").message
    os.kill(pid, signal.SIGKILL)
    client.until(lambda: client.state() == "unconfigured")
    assert "the process im_mcs.servo ended with code -9" in client.states[-1].reason
    assert client.trigger("reset").success
    assert client.change("configure")
    client.until(lambda: client.state() == "cold")


def test_a_killed_node_takes_its_servo_along(client, process):
    assert client.change("cleanup")
    other = process(sys.executable, "-m", "im_mcs.ros.node", "--ros-args", "-p", "standalone:=true", "-r", "__ns:=/x")
    panel, end = PanelEnd.attach(names.instance(), 60.0), ServoEnd.attach(names.instance(), 60.0)
    client.until(lambda: panel.servo_pid != 0)
    servo = panel.servo_pid
    other.kill()
    client.until(lambda: not os.path.exists(f"/proc/{servo}"))
    panel.request_time(2)
    client.until(lambda: panel.servo_pid == 0)
    assert end.read_state().brakes.all()
    panel.close()
    end.close()
    assert client.change("configure")


def test_a_killed_testbed_ends_the_goal_and_is_named(client):
    """The last one: the testbed does not come back. What nobody measures is not told as if it were measured."""
    client.to_motion()
    _, result = client.start_far_move()
    os.kill(_physics(), signal.SIGKILL)
    assert "the testbed's physics process is gone" in result().status.message
    client.until(lambda: client.state() == "estopped")
    assert client.lifecycle() == "inactive"
    answer = client.trigger("reset")
    assert not answer.success
    assert "the testbed does not answer" in answer.message
    client.until(lambda: not client.states[-1].power and client.states[-1].brakes)
    assert client.change("shutdown")
    client.until(lambda: client.mcs.failed)  # what the bootstrap hears, and starts the task again
    assert client.mcs.failed.startswith("/mcs is finalized by the lifecycle transition shutdown; the machine starts it")
    assert client.trigger("power_on").message == client.mcs.failed


def lifecycle_diagnosis(diagnostics):
    """The newest status of the lifecycle; an empty one before the first."""
    statuses = [status for message in diagnostics for status in message.status if status.name == "mcs: lifecycle"]
    return statuses[-1] if statuses else DiagnosticStatus()


def _physics():
    """Process id of this test's physics."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if b"im_sim.physics" in words and names.instance().encode() in words:
            return int(entry.name)
    raise AssertionError("there is no physics process")
