"""A loss leaves /mcs where the next reservation, or ``scripts/im recover``, brings it back; it tells what was lost."""

import errno
import os
import re
import signal
from concurrent.futures import ThreadPoolExecutor

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from im_bringup.ros.recover import RecoverClient
from im_cell.link import PanelEnd, ServoEnd
from im_core import names
from im_core.errors import WaitTimeoutError
from im_core.ros import qos
from im_core.ros.run import spin_in_thread
from im_mcs.ros import servo_keeper
from im_msgs.msg import TaskRecord, TaskRegistry
from im_msgs.srv import ReserveGroup


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


def test_a_machine_where_no_message_reaches_a_node_is_not_called_ready(client, recover):
    client.to_motion()
    publisher = client.node.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
    deaf = "mcs has acknowledged nothing to dispatcher for 10 s; 3 messages wait"
    statuses = [
        DiagnosticStatus(level=DiagnosticStatus.WARN, name=f"dispatcher: link to {node}", message=f"{node}: {deaf}")
        for node in ("mcs", "a_node_that_was_ended")
    ]
    timer = client.node.create_timer(0.5, lambda: publisher.publish(DiagnosticArray(status=statuses)))
    told = []
    try:
        with (
            spin_in_thread(node := RecoverClient(told.append)),
            pytest.raises(WaitTimeoutError, match=re.escape(f"(mcs: {deaf})")),
        ):
            node.recover(8.0)
    finally:
        client.node.destroy_timer(timer)
        client.node.destroy_publisher(publisher)
    assert told == [f"mcs: {deaf}"]


def test_after_an_emergency_stop(client, recover):
    client.to_motion()
    assert client.trigger("estop").success
    client.until(lambda: client.state() == "estopped")
    assert "(scripts/im recover does it)" in client.trigger("power_on").message
    summary, told = recover()
    assert summary == "ready: 1 tasks, MCS is cold"
    assert told == ["MCS is estopped: request on /mcs/estop; reset"]


def test_after_the_death_of_the_servo(client, recover):
    with PanelEnd.attach(names.instance(), 60.0) as panel:
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


def reserve(client):
    return client.call(ReserveGroup, "reserve", group="left")


def test_the_next_reservation_brings_a_dead_servo_back(client):
    client.to_motion()
    with PanelEnd.attach(names.instance(), 60.0) as panel:
        os.kill(panel.servo_pid, signal.SIGKILL)
    client.until(lambda: client.state() == "unconfigured")
    assert not client.trigger("power_on").success  # only who begins to work brings it back
    answer = reserve(client)
    assert (answer.success, answer.message) == (True, "MCS is reserved")
    assert client.trigger("power_on").success


def reserve_both(client):
    """Reserve both arms at once; the answers."""
    with ThreadPoolExecutor() as pool:
        return list(pool.map(lambda group: client.call(ReserveGroup, "reserve", group=group), ("left", "right")))


def reserved(client):
    """Groups that are reserved."""
    return {status.group for status in client.states[-1].groups if status.reserved}


def test_two_reservations_at_once_bring_a_dead_servo_back_for_both(client):
    client.to_motion()
    with PanelEnd.attach(names.instance(), 60.0) as panel:
        os.kill(panel.servo_pid, signal.SIGKILL)
    client.until(lambda: client.state() == "unconfigured")
    assert [answer.message for answer in reserve_both(client)] == ["MCS is reserved"] * 2
    client.until(lambda: reserved(client) == {"left", "right"})


def test_the_next_reservation_leaves_alone_what_was_meant(client):
    assert client.change("cleanup")
    assert not reserve(client).success
    assert client.change("configure")
    client.until(lambda: client.state() == "cold")
    assert client.trigger("estop").success
    assert "is refused in state estopped" in reserve(client).message


def test_a_servo_that_the_operating_system_does_not_start_can_be_started_again(client, monkeypatch):
    assert client.change("cleanup")
    with monkeypatch.context() as patch:

        def refuse(*_, **__):
            raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

        patch.setattr(servo_keeper.ChildProcess, "of_module", refuse)
        assert not client.change("configure")
    assert client.lifecycle() == "unconfigured"
    why = "the servo process cannot be started: [Errno 11] Resource temporarily unavailable"
    client.until(lambda: why in client.trigger("power_on").message)
    assert client.change("configure")
    client.until(lambda: client.state() == "cold")


@pytest.mark.raises
def test_a_transition_that_fails_in_another_way_ends_too(client, monkeypatch):
    assert client.change("cleanup")
    with monkeypatch.context() as patch:
        patch.setattr(servo_keeper, "ServoOwner", lambda *_: 1 / 0)
        client.change("configure")
    assert client.lifecycle() == "unconfigured"
    assert client.change("configure")


@pytest.fixture
def lose_testbed(client):
    """Stops the servo in motion until the testbed has left it, and lets it find out."""

    def lose():
        client.to_motion()
        with PanelEnd.attach(names.instance(), 60.0) as panel:
            pid, losses = panel.servo_pid, panel.servo_losses
            os.kill(pid, signal.SIGSTOP)
            try:
                panel.request_time(2)
                client.until(lambda: panel.servo_losses > losses)
                client.until(lambda: not client.states[-1].power and client.states[-1].brakes)  # not as it was
                with ServoEnd.attach(names.instance(), 60.0) as testbed:
                    state = testbed.read_state()
                    assert not state.power
                    assert state.brakes.all()
            finally:
                os.kill(pid, signal.SIGCONT)
        client.until(lambda: client.state() == "estopped" and "hangs" not in client.states[-1].reason)

    return lose


def test_the_next_reservation_after_the_testbed_was_lost(client, lose_testbed):
    lose_testbed()
    assert "the testbed declared the servo gone" in client.states[-1].reason
    answer = reserve(client)
    assert (answer.success, answer.message) == (True, "MCS is reserved")
    assert client.trigger("power_on").success


def test_two_reservations_at_once_after_the_testbed_was_lost(client, lose_testbed):
    lose_testbed()
    assert [answer.message for answer in reserve_both(client)] == ["MCS is reserved"] * 2
    client.until(lambda: reserved(client) == {"left", "right"})


def test_an_operator_who_stops_after_a_loss_is_not_overruled(client, lose_testbed, monkeypatch):
    lose_testbed()
    keeper = client.mcs._mcs.keeper
    assert keeper.lost
    with monkeypatch.context() as patch:
        patch.setattr(client.mcs, "spawn", lambda work: work.close())  # the loop comes to it after the answer
        keeper.estop("the operator")
        assert not keeper.lost
    assert client.trigger("estop").success
    assert "is refused in state estopped" in reserve(client).message
    assert client.trigger("reset").success
    assert reserve(client).success
