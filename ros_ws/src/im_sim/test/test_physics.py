"""The physics process as others meet it: through the link."""

import contextlib
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from im_cell.link import CameraEnd, Drive, HostEnd, PanelEnd, ServoEnd
from im_core import clock
from im_core.errors import LinkError
from im_core.shm_names import remove_all

INSTANCE = f"imtest{os.getpid()}"
N = 18
HELD, FREE = np.ones(N, dtype=bool), np.zeros(N, dtype=bool)
CLOSED = np.zeros(2)


@contextlib.contextmanager
def physics(*arguments, instance=INSTANCE):
    process = subprocess.Popen(
        [sys.executable, "-m", "im_sim.physics", "--instance", instance, *arguments],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()
        remove_all(f"{instance}_")


@contextlib.contextmanager
def attached(*kinds, instance=INSTANCE):
    """Ends of the link, one of each kind."""
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(kind.attach(instance, timeout_s=60.0)) for kind in kinds]


def drive(servo, time, ticks, tau):
    """Be the servo for some ticks; the states seen, as bytes."""
    servo.attach_servo(os.getpid())
    time.request_time(1)
    seen = []
    for count in range(ticks):
        assert servo.wait_state(60.0)
        state = servo.read_state()
        seen.append((state.tick, state.q.tobytes(), state.gripper.tobytes()))
        servo.write_command(Drive(tau * np.sin(0.1 * count), True, FREE, CLOSED, count < ticks - 1, CLOSED))
    time.wait_tick(ticks, timeout_s=60.0)
    return seen


def test_two_processes_with_one_seed_give_the_same_bits():
    tau = np.linspace(-30.0, 30.0, N)
    options = ("--factor", "0", "--seed", "5")
    runs = []
    with physics(*options), physics(*options, instance=f"{INSTANCE}b"):
        for instance in (INSTANCE, f"{INSTANCE}b"):
            with attached(ServoEnd, PanelEnd, HostEnd, instance=instance) as (servo, time, host):
                runs.append(drive(servo, time, 100, tau))
                assert np.abs(host.read_truth().v).max() > 0.01
    assert runs[0] == runs[1]


def test_a_session_at_factor_0():
    ends = CameraEnd, HostEnd, PanelEnd, ServoEnd
    with physics("--factor", "0", "--seed", "1") as process, attached(*ends) as (camera, host, panel, servo):
        clock.sleep(0.05)
        assert panel.tick == 0, "time passes only while something waits for it"
        state = servo.read_state()
        assert not state.power
        assert state.brakes.all()

        panel.set_light(0, True)
        on = camera.expose(3, blank_light=False, timeout_s=60.0)
        off = camera.expose(3, blank_light=True, timeout_s=60.0)
        assert (on.start_tick, on.end_tick, off.start_tick, off.end_tick) == (0, 3, 3, 6)
        assert on.light_fraction == {"left_led": 1.0, "right_led": 0.0}
        assert off.light_fraction == {"left_led": 0.0, "right_led": 0.0}
        np.testing.assert_allclose(on.q_true, host.read_truth().q, atol=1e-12)
        assert np.abs(on.q_true - state.q).max() < 1e-4

        panel.wait_tick(panel.request_time(1000), timeout_s=60.0)
        assert panel.tick == 1006

        process.send_signal(signal.SIGTERM)
        assert process.wait(60.0) == 0
        with pytest.raises(LinkError, match="physics process is gone"):
            camera.expose(1, blank_light=False, timeout_s=60.0)
        with pytest.raises(LinkError, match="does not exist"):
            ServoEnd.attach(INSTANCE, timeout_s=0.0)


def test_real_time_keeps_pace_alone_and_outlives_its_servo():
    with physics("--factor", "1"), attached(PanelEnd, ServoEnd) as (panel, servo):
        panel.wait_tick(20, timeout_s=60.0)  # the loop runs
        start, begin = panel.tick, clock.monotonic()
        panel.wait_tick(start + 60, timeout_s=60.0)  # it goes on, how evenly the bench tells, ...
        passed, wall = (panel.tick - start) * panel.period_s, clock.monotonic() - begin
        assert passed < wall + 0.05  # ... and not ahead of time

        servo.attach_servo(os.getpid())
        assert servo.wait_state(60.0)
        servo.write_command(Drive(np.zeros(N), True, HELD, CLOSED, True, CLOSED))
        assert servo.wait_state(60.0)
        assert servo.read_state().power
        panel.wait_tick(panel.tick + 10, timeout_s=60.0)  # no further command: declared gone after 0.5 s
        assert panel.servo_losses == 1
        with pytest.raises(LinkError, match="the testbed declared the servo gone"):
            servo.read_state()
        state = servo.read_state()  # it has been told once
        assert not state.power
        assert state.brakes.all()


def test_a_killed_machine_is_replaced_and_a_living_one_is_not():
    with physics("--factor", "0") as first, attached(ServoEnd) as (old,):
        second = subprocess.run(
            [*first.args], capture_output=True, text=True, check=False,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        )  # fmt: skip
        assert second.returncode == 1
        assert f"in use by process {first.pid}" in second.stderr.splitlines()[-1]
        first.send_signal(signal.SIGKILL)
        first.wait()
        assert not old.physics_alive()
        with physics("--factor", "0"), attached(PanelEnd) as (new,):
            assert new.wait_tick(new.request_time(5), timeout_s=60.0) == 5


def test_a_wrong_cell_file_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_CELL", str(tmp_path / "none.yaml"))
    with physics() as process:
        _, errors = process.communicate(timeout=60.0)
        assert process.returncode == 1
        assert "none.yaml: cannot be read" in errors.splitlines()[-1]
