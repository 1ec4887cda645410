"""Both ends of the link in one process; the physics end in a thread of its own."""

import contextlib
import os
import threading

import numpy as np
import pytest

from im_cell.link import (
    CameraEnd,
    ClockEnd,
    Drive,
    HostEnd,
    LaserBeam,
    LaserEnd,
    PanelEnd,
    RateEnd,
    Sensors,
    ServoEnd,
)
from im_cell.link import host as host_module
from im_core import clock
from im_core.errors import DataError, LinkError, WaitTimeoutError
from im_core.shm_names import remove_all

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
    link = HostEnd.create(INSTANCE, n_joints=N, period_s=0.01, factor=0.0, seed=7)
    publish(link, 0)
    yield link
    link.close()
    assert remove_all(INSTANCE) == []


def end_of(kind):
    """A fixture that attaches an end."""

    @pytest.fixture
    def end(host):
        with kind.attach(INSTANCE, timeout_s=60.0) as attached:
            yield attached

    return end


servo, time, camera, panel = end_of(ServoEnd), end_of(ClockEnd), end_of(CameraEnd), end_of(PanelEnd)
laser, rates = end_of(LaserEnd), end_of(RateEnd)


@contextlib.contextmanager
def running(host, commands, timeout_s=60.0):
    """Physics that only counts ticks and keeps the commands it got."""
    end = threading.Event()

    def run():
        while not end.is_set():
            if host.await_demand(0.01):
                host.post_state()
                commands.append(host.await_command(timeout_s))
                publish(host, host.tick + 1)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


def test_attaching_tells_what_was_created(time):
    assert (time.n_joints, time.period_s, time.factor, time.seed) == (N, 0.01, 0.0, 7)
    assert time.light_names == ("left_led", "right_led")
    assert time.tick == 0
    assert time.physics_alive()


def test_link_cannot_be_attached_before_the_first_state():
    link = HostEnd.create(INSTANCE, n_joints=N)
    with pytest.raises(LinkError, match="is not initialised"):
        ServoEnd.attach(INSTANCE, timeout_s=0.0)
    link.close()


@pytest.mark.parametrize(("arguments", "message"), [
    ({"period_s": 0.0}, "period 0.0 s is not > 0"),
    ({"factor": -1.0}, "factor -1.0 is not >= 0"),
    ({"light_names": ("a",) * 9}, "9 lights are more than 8"),
])  # fmt: skip
def test_nonsense_is_refused(arguments, message):
    with pytest.raises(DataError, match=message):
        HostEnd.create(INSTANCE, **arguments)


def test_each_tick_gets_its_own_command(host, servo, time):
    commands = []
    servo.attach_servo(os.getpid())
    with running(host, commands):
        time.request_time(1)
        for tick in range(5):
            assert servo.wait_state(60.0)
            state = servo.read_state()
            assert state.tick == tick
            assert state.stamp_ns == tick * 10_000_000
            assert (state.q == tick).all()
            servo.write_command(Drive(np.full(N, 10.0 * tick), True, NO_BRAKES, OPEN, tick < 4, OPEN))
        time.wait_tick(5, timeout_s=60.0)
        assert not servo.wait_state(0.05), "nobody wants time"
    assert [command.command[0] for command in commands] == [0.0, 10.0, 20.0, 30.0, 40.0]
    assert all(command.power and not command.brakes.any() for command in commands)


def test_time_passes_only_as_far_as_it_is_asked_for(host, time):
    with running(host, []):
        until = time.request_time(20)
        assert time.wait_tick(until, timeout_s=60.0) == 20
        clock.sleep(0.05)
        assert time.tick == 20
        with pytest.raises(WaitTimeoutError, match="tick 21 of the testbed"):
            time.wait_tick(21, timeout_s=0.05)


def test_silent_servo_is_declared_gone_told_so_and_may_come_back(host, servo, panel):
    commands = []
    servo.attach_servo(os.getpid())
    with running(host, commands, timeout_s=0.5):
        until = panel.request_time(2)
        panel.wait_tick(until, timeout_s=60.0)
        assert commands == [None, None]
        assert panel.servo_losses == 1
        with pytest.raises(LinkError, match="declared the servo gone"):
            servo.write_command(Drive(np.zeros(N), True, NO_BRAKES, OPEN, True, OPEN))
        servo.attach_servo(os.getpid())
        panel.request_time(1)
        assert servo.wait_state(60.0)
        servo.write_command(Drive(np.ones(N), True, NO_BRAKES, OPEN, False, OPEN))
        panel.wait_tick(3, timeout_s=60.0)
    assert commands[2].command.tolist() == [1.0, 1.0, 1.0]


def test_a_servo_that_waits_hears_that_it_was_declared_gone(host, servo, panel):
    servo.attach_servo(os.getpid())
    with running(host, [], timeout_s=0.5):
        assert not servo.wait_state(0.05), "nobody wants time"
        panel.request_time(1)
        assert servo.wait_state(60.0)
        panel.wait_tick(1, timeout_s=60.0)  # what it has read it has not answered
        with pytest.raises(LinkError, match="declared the servo gone before tick 1"):
            servo.wait_state(0.05)


def test_a_servo_that_attaches_again_answers_the_tick_that_came_meanwhile(host, servo, panel):
    commands = []
    servo.attach_servo(os.getpid())
    with running(host, commands):
        panel.request_time(1)
        assert servo.wait_state(60.0)
        servo._shared.state.post()  # as if it had not looked yet
        servo.attach_servo(os.getpid())
        assert servo.wait_state(60.0)
        servo.write_command(Drive(np.ones(N), True, NO_BRAKES, OPEN, False, OPEN))
        panel.wait_tick(1, timeout_s=60.0)
    assert panel.servo_losses == 0
    assert commands[0].command.tolist() == [1.0, 1.0, 1.0]


def test_a_servo_that_was_declared_gone_commands_nothing_once_another_has_come(host, servo, panel):
    commands = []
    servo.attach_servo(os.getpid())
    with running(host, commands, timeout_s=0.5), ServoEnd.attach(INSTANCE, timeout_s=60.0) as other:
        panel.wait_tick(panel.request_time(1), timeout_s=60.0)
        assert panel.servo_losses == 1
        other.attach_servo(os.getppid())
        panel.request_time(1)
        assert other.wait_state(60.0)
        own = Drive(np.ones(N), True, NO_BRAKES, OPEN, False, OPEN)
        for _ in range(2):
            with pytest.raises(LinkError, match=f"gone before tick 1; process {os.getppid()} is its servo now"):
                servo.write_command(Drive(np.full(N, 99.0), True, NO_BRAKES, OPEN, True, OPEN))
        servo.detach_servo()
        other.write_command(own)
        panel.wait_tick(2, timeout_s=60.0)
    assert commands[0] is None
    assert commands[1].command.tolist() == [1.0, 1.0, 1.0]


def test_detaching_ends_the_demand(host, servo, time):
    with running(host, []):
        servo.attach_servo(os.getpid())
        time.request_time(1)
        assert servo.wait_state(60.0)
        servo.write_command(Drive(np.zeros(N), True, NO_BRAKES, OPEN, True, OPEN))
        assert servo.wait_state(60.0)
        servo.detach_servo()
        time.wait_tick(2, timeout_s=60.0)
        clock.sleep(0.03)
        assert time.tick == 2


def test_only_one_servo(servo):
    servo.attach_servo(os.getppid())
    with pytest.raises(LinkError, match=f"already has a servo, process {os.getppid()}"):
        servo.attach_servo(os.getpid())
    with pytest.raises(LinkError, match="does not run"):
        servo.attach_servo(2**22 + 1)


def test_exposure_is_demand_and_is_answered(host, camera):
    def serve():
        while (request := host.pending_exposure()) is None:
            clock.sleep(0.001)
        assert host.demand()
        assert (request.ticks, request.blank_light) == (2, True)
        host.finish_exposure(request, 3, 5, np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.5]), LaserBeam())

    thread = threading.Thread(target=serve)
    thread.start()
    exposure = camera.expose(2, blank_light=True, timeout_s=60.0)
    thread.join()
    assert (exposure.start_tick, exposure.end_tick, exposure.stamp_ns) == (3, 5, 40_000_000)
    assert exposure.q_true.tolist() == [1.0, 2.0, 3.0]
    assert exposure.light_fraction == {"left_led": 0.0, "right_led": 0.5}
    assert not host.demand()


def test_exposure_that_nobody_serves_times_out_and_is_replaced(host, camera):
    who = rf"by the testbed's physics \(process {os.getpid()}\)"
    with pytest.raises(WaitTimeoutError, match=f"an exposure of 2 ticks {who}"):
        camera.expose(2, blank_light=False, timeout_s=0.02)
    with pytest.raises(WaitTimeoutError, match="an exposure of 3 ticks"):
        camera.expose(3, blank_light=False, timeout_s=0.02)
    assert host.pending_exposure().ticks == 3
    with pytest.raises(DataError, match="exposure of 0 ticks is not between 1 and 10000"):
        camera.expose(0, blank_light=False, timeout_s=0.02)


def test_time_waits_for_an_image_that_is_due(host, time, camera, rates, monkeypatch):
    monkeypatch.setattr(host_module, "IMAGE_PATIENCE_S", 60.0)
    rates.await_image(31_000_000)
    with running(host, []):
        time.request_time(10)
        time.wait_tick(4, timeout_s=60.0)
        clock.sleep(0.03)
        assert time.tick == 4
        rates.await_image(70_000_000)
        time.wait_tick(7, timeout_s=60.0)
        clock.sleep(0.03)
        assert time.tick == 7
        rates.await_image(None)
        time.wait_tick(10, timeout_s=60.0)


def test_who_takes_the_image_has_the_time_that_it_takes(host, time, camera, laser, rates, monkeypatch):
    monkeypatch.setattr(host_module, "IMAGE_PATIENCE_S", 60.0)
    rates.await_image(0)
    publish(host, 1)
    time.request_time(9)
    assert not host.demand()
    with pytest.raises(WaitTimeoutError, match="an exposure of 2 ticks"):
        camera.expose(2, blank_light=False, timeout_s=0.02)
    assert host.demand()
    host.finish_exposure(host.pending_exposure(), 1, 3, np.zeros(N), np.zeros(2), LaserBeam())
    assert not host.demand()
    laser.request_time(1)
    assert host.demand()


def test_an_image_that_does_not_come_is_waited_for_once(host, time, rates, monkeypatch):
    monkeypatch.setattr(host_module, "IMAGE_PATIENCE_S", 0.05)
    rates.await_image(20_000_000)
    with running(host, []):
        time.request_time(50)
        time.wait_tick(50, timeout_s=60.0)


def test_lights(host, panel):
    panel.set_light(1, True)
    assert host.lights() == (False, True)
    with pytest.raises(DataError, match="light 2 is not one of 0 to 1"):
        panel.set_light(2, True)


def test_an_end_can_do_what_its_user_may_do_and_no_more():
    def able(kind):
        return {name for name in dir(kind) if not name.startswith("_")}

    host = {"publish_state", "publish_laser", "read_truth", "await_command", "await_demand", "finish_exposure"}
    assert able(HostEnd) >= host
    for kind in (ServoEnd, CameraEnd, RateEnd, LaserEnd, PanelEnd, ClockEnd):
        assert not able(kind) & host
    assert able(CameraEnd) - able(LaserEnd) == {"expose"}
    assert able(RateEnd) - able(LaserEnd) == {"await_image"}
    assert able(LaserEnd) - able(ClockEnd) == {"set_laser", "laser"}
    assert not able(ServoEnd) & {"expose", "set_laser", "set_faults", "set_light", "request_time"}
