"""Both ends of the link in one process; the physics end in a thread of its own."""

import contextlib
import os
import threading

import numpy as np
import pytest

from im_core import clock
from im_core.errors import DataError, LinkError, WaitTimeoutError
from im_core.shm import remove_all
from im_core.testbed_link import Command, LaserBeam, Sensors, Slot, TestbedLink

INSTANCE = f"imtest{os.getpid()}"
N = 3
NO_BRAKES = np.zeros(N, dtype=bool)
OPEN = np.zeros(2)


def publish(link, tick):
    q = np.full(N, float(tick))
    sensors = Sensors(q, False, ~NO_BRAKES, OPEN, 0.1 * q, np.full((2, 6), q[0]), OPEN + 7.0)
    link.publish_state(tick, sensors, q + 0.5, -q)


@pytest.fixture
def host():
    link = TestbedLink.create(INSTANCE, n_joints=N, period_s=0.01, factor=0.0, seed=7)
    publish(link, 0)
    yield link
    link.close()
    assert remove_all(INSTANCE) == []


@pytest.fixture
def client(host):
    link = TestbedLink.attach(INSTANCE, timeout_s=1.0)
    yield link
    link.close()


@contextlib.contextmanager
def running(host, commands, timeout_s=0.5):
    """Physics that only counts ticks and keeps the commands it got."""
    end = threading.Event()

    def run():
        while not end.is_set():
            if host.await_demand(0.01):
                commands.append(host.await_command(timeout_s))
                publish(host, host.tick + 1)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


def test_attaching_tells_what_was_created(client):
    assert (client.n_joints, client.period_s, client.factor, client.seed) == (N, 0.01, 0.0, 7)
    assert client.light_names == ("left_led", "right_led")
    assert client.tick == 0
    assert client.physics_alive()


def test_link_cannot_be_attached_before_the_first_state():
    link = TestbedLink.create(INSTANCE, n_joints=N)
    with pytest.raises(LinkError, match="is not initialised"):
        TestbedLink.attach(INSTANCE, timeout_s=0.0)
    link.close()


@pytest.mark.parametrize(("arguments", "message"), [
    ({"period_s": 0.0}, "period 0.0 s is not > 0"),
    ({"factor": -1.0}, "factor -1.0 is not >= 0"),
    ({"light_names": ("a",) * 9}, "9 lights are more than 8"),
])  # fmt: skip
def test_nonsense_is_refused(arguments, message):
    with pytest.raises(DataError, match=message):
        TestbedLink.create(INSTANCE, **arguments)


def test_each_tick_gets_its_own_command(host, client):
    commands = []
    client.attach_servo(os.getpid())
    with running(host, commands):
        client.request_time(Slot.MCS, 1)
        for tick in range(5):
            assert client.wait_state(1.0)
            state = client.read_state()
            assert state.tick == tick
            assert state.stamp_ns == tick * 10_000_000
            assert (state.q == tick).all()
            client.write_command(Command(np.full(N, 10.0 * tick), True, NO_BRAKES, OPEN, tick < 4, OPEN))
        client.wait_tick(5, timeout_s=1.0)
        assert not client.wait_state(0.05), "nobody wants time"
    assert [command.tau[0] for command in commands] == [0.0, 10.0, 20.0, 30.0, 40.0]
    assert all(command.power and not command.brakes.any() for command in commands)


def test_time_passes_only_as_far_as_it_is_asked_for(host, client):
    with running(host, []):
        until = client.request_time(Slot.TESTBED, 20)
        assert client.wait_tick(until, timeout_s=1.0) == 20
        clock.sleep(0.05)
        assert client.tick == 20
        with pytest.raises(WaitTimeoutError, match="tick 21 of the testbed"):
            client.wait_tick(21, timeout_s=0.05)


def test_silent_servo_is_declared_gone_told_so_and_may_come_back(host, client):
    commands = []
    client.attach_servo(os.getpid())
    with running(host, commands, timeout_s=0.1):
        until = client.request_time(Slot.TESTBED, 2)
        client.wait_tick(until, timeout_s=2.0)
        assert commands == [None, None]
        assert client.read_truth().servo_losses == 1
        with pytest.raises(LinkError, match="declared the servo gone"):
            client.write_command(Command(np.zeros(N), True, NO_BRAKES, OPEN, True, OPEN))
        client.attach_servo(os.getpid())
        client.request_time(Slot.TESTBED, 1)
        assert client.wait_state(1.0)
        client.write_command(Command(np.ones(N), True, NO_BRAKES, OPEN, False, OPEN))
        client.wait_tick(3, timeout_s=1.0)
    assert commands[2].tau.tolist() == [1.0, 1.0, 1.0]


def test_detaching_ends_the_demand(host, client):
    with running(host, []):
        client.attach_servo(os.getpid())
        client.request_time(Slot.MCS, 1)
        assert client.wait_state(1.0)
        client.write_command(Command(np.zeros(N), True, NO_BRAKES, OPEN, True, OPEN))
        assert client.wait_state(1.0)
        client.detach_servo()
        client.wait_tick(2, timeout_s=1.0)
        clock.sleep(0.03)
        assert client.tick == 2


def test_only_one_servo(client):
    client.attach_servo(os.getppid())
    with pytest.raises(LinkError, match=f"already has a servo, process {os.getppid()}"):
        client.attach_servo(os.getpid())
    with pytest.raises(LinkError, match="does not run"):
        client.attach_servo(2**22 + 1)


def test_exposure_is_demand_and_is_answered(host, client):
    def serve():
        while (request := host.pending_exposure()) is None:
            clock.sleep(0.001)
        assert host.demand()
        assert (request.ticks, request.blank_light) == (2, True)
        host.finish_exposure(request, 3, 5, np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.5]), LaserBeam())

    thread = threading.Thread(target=serve)
    thread.start()
    exposure = client.expose(2, blank_light=True, timeout_s=2.0)
    thread.join()
    assert (exposure.start_tick, exposure.end_tick, exposure.stamp_ns) == (3, 5, 40_000_000)
    assert exposure.q_true.tolist() == [1.0, 2.0, 3.0]
    assert exposure.light_fraction == {"left_led": 0.0, "right_led": 0.5}
    assert not host.demand()


def test_exposure_that_nobody_serves_times_out_and_is_replaced(host, client):
    with pytest.raises(WaitTimeoutError, match="an exposure of 2 ticks"):
        client.expose(2, blank_light=False, timeout_s=0.02)
    with pytest.raises(WaitTimeoutError, match="an exposure of 3 ticks"):
        client.expose(3, blank_light=False, timeout_s=0.02)
    assert host.pending_exposure().ticks == 3
    with pytest.raises(DataError, match="exposure of 0 ticks is not between 1 and 10000"):
        client.expose(0, blank_light=False, timeout_s=0.02)


def test_lights(host, client):
    client.set_light(1, True)
    assert host.lights() == (False, True)
    with pytest.raises(DataError, match="light 2 is not one of 0 to 1"):
        client.set_light(2, True)
