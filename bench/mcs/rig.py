"""MCS in this process over the testbed's physics in another: everything that goes on in a tick can be looked at."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.mcs.physics import new_instance, physics
from im_cell.link import ClockEnd, HostEnd
from im_cell.robot import load_cell
from im_core.errors import ImError, StateError
from im_mcs.limits.configuration import McsConfig
from im_mcs.model import CellModel
from im_mcs.protocol.channel import evidence_type
from im_mcs.protocol.evidence import KEPT, Recorder
from im_mcs.servo.core import Mcs
from im_mcs.testbed import TestbedInterface

_WAIT_S = 0.05
_MOST_TICKS = 20_000

# Both ends of a move of more than 1 rad (1 m) in every joint, free of collisions.
START = np.array([-1.7, -0.5, -0.3, -0.6, 1.2, -2.8, -0.6, -0.7, -1.0, 0.6, 0.4, 0.3, 0.5, 1.9, -2.6, 0.6, 0.7, 1.0])
WAY = np.array([1.05, 1.2, 1.02, 1.2, 1.05, 1.2, 1.3, 1.3, 1.4, 1.05, -1.1, -1.02, -1.2, -1.05, 1.2, -1.2, -1.3, -1.4])

OnTick = Callable[[], None]


class Rig:
    """MCS, its requests and answers, and the truth that only the testbed knows.

    Args:
        config: Configuration.
        model: Kinematics and dynamics.
        testbed: The slots, connected.
        host: The testbed's own end of the link, which knows the truth.
        time: Asks for time.

    Attributes:
        true_q: Where the joints really were at the begin of the last tick, shape (18,) [rad or m].
    """

    def __init__(
        self, config: McsConfig, model: CellModel, testbed: TestbedInterface, host: HostEnd, time: ClockEnd
    ) -> None:
        self.model = model
        self.events: list[dict[str, Any]] = []
        self.mcs = Mcs(config, model, testbed, self.events.append, Recorder(np.zeros(KEPT, evidence_type(config))))
        self._testbed, self._host, self._time = testbed, host, time
        self._number = 0
        self.true_q: NDArray[np.float64] = host.read_truth().q

    @property
    def setpoint(self) -> NDArray[np.float64]:
        """Positions, velocities and accelerations that are followed, shape (3, 18)."""
        return self.mcs.loop.setpoint

    def tick(self, messages: Sequence[dict[str, Any]] = ()) -> None:
        """One servo tick."""
        if not self.mcs.wants_time:
            self._time.request_time(1)
        while not self._testbed.wait(_WAIT_S):
            self._time.request_time(1)
        self.true_q = self._host.read_truth().q
        self.mcs.tick(messages)

    def ask(self, request: str, on_tick: OnTick = lambda: None, **arguments: Any) -> dict[str, Any]:
        """Send a request and let time pass until it is answered.

        Returns:
            The results of the answer.

        Raises:
            ImError: The request was refused, or ended with a fault.
            StateError: It is not answered.
        """
        self._number += 1
        messages = [{"id": self._number, "request": request, "arguments": arguments}]
        for _ in range(_MOST_TICKS):
            self.tick(messages)
            on_tick()
            messages = []
            for event in self.events:
                if event["event"] == "reply" and event["id"] == self._number:
                    if error := event.get("error"):
                        raise ImError.restored(error["code"], f"{request}: {error['message']}", error["facts"])
                    return dict(event["results"])
            self.events.clear()
        raise StateError(f"{request} was not answered within {_MOST_TICKS} ticks")

    def to_motion(self, *groups: str) -> None:
        """Reserve groups, give them power and release their brakes."""
        for group in groups:
            self.ask("reserve", group=group)
        self.ask("power_on")
        self.ask("enable_motion")

    def move(self, group: str, *points: NDArray[np.float64], on_tick: OnTick = lambda: None) -> dict[str, Any]:
        """Move through points, shape (n,) each, and wait for the end."""
        path = {"kind": "joint", "points": [point.tolist() for point in points]}
        return self.ask("move", on_tick, group=group, path=path)


@contextmanager
def rig(config: McsConfig, seed: int = 1) -> Iterator[Rig]:
    """A rig in lockstep with a testbed of its own, as fast as it goes."""
    cell, instance = load_cell(), new_instance()
    with (
        tempfile.TemporaryDirectory(prefix="im_bench_") as folder,
        physics(instance, cell, 0.0, seed, Path(folder)) as (host, _),
        ClockEnd.attach(instance, _WAIT_S) as time,
    ):
        testbed = TestbedInterface.load(config.testbed, config.slots, instance)
        testbed.connect()
        made = Rig(config, CellModel(cell), testbed, host, time)
        try:
            yield made
        finally:
            made.mcs.close()
            testbed.close()
