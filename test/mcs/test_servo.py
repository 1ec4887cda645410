"""The servo process against the physics process, without ROS: two runs of one seed are the same to the last bit."""

import contextlib
import os
import subprocess
import sys

import numpy as np
import pytest

from im_cell.link import ClockEnd
from im_cell.robot import load_cell
from im_core import clock
from im_mcs.client.servo_client import ServoClient, ask
from im_mcs.client.time_source import TestbedTime
from im_mcs.limits.configuration import load_config
from im_mcs.protocol.channel import ServoChannel, channel_name
from im_mcs.state import Event
from support.mcs_config import write_mcs_config

HOME = load_cell().home[:9]
POINTS = [
    HOME + np.array([0.10, 0.3, 0.1, 0.3, -0.3, 0.3, 0.4, 0.4, 0.4]),
    HOME + np.array([-0.2, -0.3, 0.0, -0.4, 0.2, 0.1, -0.5, 0.2, 1.0]),
]

FIGURES = ("ticks", "missed_deadlines", "mean_period_s", "max_lateness_s")


def run(
    instance: str, factor: float, pause_s: float, points: list[np.ndarray], config_file: str = ""
) -> tuple[list[tuple[int, list[float]]], dict[str, float]]:
    """Move to the points; tick and rest position after each, and what the servo says of itself."""
    config = load_config()
    arguments = ["im_sim.physics", "--instance", instance, "--factor", str(factor), "--seed", "7"]
    with contextlib.ExitStack() as stack:
        stack.enter_context(_process(*arguments))
        link = ClockEnd.attach(instance, 60.0)
        made = ServoChannel.create(channel_name(instance), ServoChannel.layout(config))
        channel = stack.enter_context(contextlib.closing(made))
        servo = stack.enter_context(_process("im_mcs.servo", instance, config_file))
        client = stack.enter_context(contextlib.closing(ServoClient(channel, TestbedTime(link))))
        deadline = clock.monotonic() + 60.0
        while channel.snapshot.sequence == 0:  # time passes for whoever asks, also before the servo is there
            assert servo.poll() is None, "the servo ended"
            assert clock.monotonic() < deadline, "the servo did not come"
            clock.sleep(0.01)
        steps = []
        for event, given in ((Event.RESERVE, {"group": "left"}), (Event.POWER_ON, None), (Event.ENABLE_MOTION, None)):
            reply = ask(client, event, given, 60.0)
            assert reply.error is None, reply.error
        for point in points:
            clock.sleep(pause_s)
            arguments = {"group": "left", "path": {"kind": "joint", "points": [point.tolist()], "blend": 0.0}}
            reply = ask(client, Event.MOVE, arguments, 60.0)
            assert reply.error is None, reply.error
            snapshot = client.snapshot()
            steps.append((int(snapshot["tick"]), snapshot["q_rest"][:9].tolist()))
        servo.terminate()
        assert servo.wait(60.0) == 0
        return steps, {name: float(snapshot[name]) for name in FIGURES}


@contextlib.contextmanager
def _process(*arguments: str):
    """A Python module that runs until the end of the block."""
    process = subprocess.Popen([sys.executable, "-m", *arguments])
    try:
        yield process
    finally:
        process.terminate()
        process.wait(60.0)


def test_two_runs_are_the_same_whoever_is_faster():
    first, _ = run(f"im_test_{os.getpid()}_a", 0.0, 0.0, POINTS)
    second, _ = run(f"im_test_{os.getpid()}_a", 0.0, 0.07, POINTS)
    assert first == second
    for (_, q), point in zip(first, POINTS, strict=True):
        np.testing.assert_allclose(q, point, atol=1e-4)


def test_in_real_time_every_period_is_a_tick_or_counted_as_missed(tmp_path):
    """How many are missed, and how late they are, is the computer's doing: ``scripts/bench.sh --mcs deadlines``."""
    config = write_mcs_config(tmp_path, servo={"max_overruns": 10_000})
    steps, servo = run(f"im_test_{os.getpid()}_b", 1.0, 0.0, POINTS[:1], str(config))
    np.testing.assert_allclose(steps[-1][1], POINTS[0], atol=1e-4)
    period_s, ticks = load_config().servo.period_s, servo["ticks"] - 1
    periods = ticks + servo["missed_deadlines"]
    assert ticks * servo["mean_period_s"] == pytest.approx(periods * period_s, abs=period_s + servo["max_lateness_s"])
