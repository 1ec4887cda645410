"""Servo and physics as they are in the machine: two processes, joined by semaphores; and a client of the servo."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.mcs.physics import new_instance, physics
from im_cell.link import ClockEnd, HostEnd
from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import LinkError
from im_core.processes.process import ChildProcess
from im_mcs.client.servo_client import ServoClient, ask
from im_mcs.client.time_source import TestbedTime
from im_mcs.limits.configuration import McsConfig
from im_mcs.protocol.channel import ServoChannel, channel_name
from im_mcs.state import Event

_READY_S = 120.0
_MOVE_S = 60.0
_POLL_S = 0.01


class Machine:
    """A running servo.

    Args:
        client: The way to talk to it.
        link: The testbed's clock.
        pids: Process ids of servo and physics.
    """

    def __init__(self, client: ServoClient, link: HostEnd, pids: dict[str, int]) -> None:
        self.client = client
        self.link = link
        self.pids = pids

    def ask(self, event: Event, **arguments: Any) -> dict[str, Any]:
        """Send a request and wait for its answer; its results.

        Raises:
            ImError: It was refused or ended with a fault.
            LinkError: There is no answer.
        """
        reply = ask(self.client, event, arguments, _MOVE_S)
        if reply.error is not None:
            raise reply.error
        return reply.results

    def to_motion(self, group: str) -> None:
        """Reserve a group, give it power and release the brakes."""
        self.ask(Event.RESERVE, group=group)
        self.ask(Event.POWER_ON)
        self.ask(Event.ENABLE_MOTION)

    def move(self, group: str, target: NDArray[np.float64]) -> None:
        """Move to positions, shape (n,) [rad or m], and wait for the end."""
        self.ask(Event.MOVE, group=group, path={"kind": "joint", "points": [target.tolist()]})


@contextmanager
def machine(config: McsConfig, factor: float, seed: int) -> Iterator[Machine]:
    """Servo and physics of a machine of their own; ended afterwards.

    Raises:
        LinkError: A process does not start; its last words.
    """
    instance = new_instance()
    with tempfile.TemporaryDirectory(prefix="im_bench_") as name:
        folder = Path(name)
        cell = load_cell().at_period(config.servo.period_s)
        with physics(instance, cell, factor, seed, folder) as (link, pid):
            channel = ServoChannel.create(channel_name(instance), ServoChannel.layout(config))
            process = _servo(instance, config, folder)
            try:
                _await_snapshot(channel, process)
                client = ServoClient(channel, TestbedTime(ClockEnd.attach(instance, 1.0)))
                try:
                    yield Machine(client, link, {"servo": process.pid, "physics": pid})
                finally:
                    client.close()
            finally:
                process.stop()
                channel.close()


def _servo(instance: str, config: McsConfig, folder: Path) -> ChildProcess:
    file = folder / "mcs.yaml"
    file.write_text(config.model_dump_json(), encoding="utf-8")  # JSON is YAML
    return ChildProcess.of_module("im_mcs.servo", [instance, str(file)], log=folder / "servo.log")


def _await_snapshot(channel: ServoChannel, process: ChildProcess) -> None:
    deadline = clock.monotonic() + _READY_S
    while channel.snapshot.sequence == 0:
        process.check()
        if clock.monotonic() > deadline:
            raise LinkError(f"the servo process is not ready: {process.last_words() or 'it says nothing'}")
        clock.sleep(_POLL_S)
