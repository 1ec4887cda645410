"""Two moves on two arms at once against the longer one alone, in simulated time."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import rclpy
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions

from bench.figures import Line
from im_bringup.machine import stop
from im_bringup.machine.start import start
from im_bringup.tasks import deployment as deployments
from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import StateError, WaitTimeoutError
from im_core.ros import qos
from im_core.ros.guard import GuardedActionClient, GuardedNode
from im_core.ros.run import Spinner
from im_msgs.action import ExecuteCommand
from im_msgs.msg import Firing

START_S = 120.0
ANSWER_S = 120.0
MOST = 1.05
#: How far a target is from home at most: cart [m, rad, rad], then the arm [rad].
SPREAD = np.array([0.3, 0.3, 0.1, 0.6, 0.3, 0.4, 0.5, 0.3, 0.5])
#: How far it keeps from the limits [m or rad].
CLEAR = 0.05


class PairClient(GuardedNode):
    """Sends commands together, and notes when the net of the cell begins and ends them."""

    def __init__(self) -> None:
        super().__init__("bench_pairs")
        self._stamps: dict[int, list[float]] = {}
        self._execute: ActionClient = GuardedActionClient(self, ExecuteCommand, "/dispatcher/execute")
        self.create_subscription(Firing, "/pnt/firings", self._note, qos.EVENTS)

    def run(self, commands: Iterable[tuple[str, Mapping[str, object]]]) -> float:
        """Runs commands, all sent at once; returns how long they took together, simulated time [s].

        Raises:
            StateError: One failed.
        """
        self._wait_for(self._execute.server_is_ready, "the action of the dispatcher")
        assert self.executor is not None, "the node spins"
        goals = [ExecuteCommand.Goal(symbol=symbol, arguments=json.dumps(given)) for symbol, given in commands]
        sent = [self.executor.create_task(self._execute.send_goal_async, goal) for goal in goals]
        self._stamps.clear()
        handles = [self._done(self._done(each)) for each in sent]
        results = [self._done(handle.get_result_async()).result for handle in handles]
        for result in results:
            if not result.success:
                raise StateError(f"a move failed: {result.status.message}")
        self._wait_for(lambda: len([ends for ends in self._stamps.values() if len(ends) == 2]) >= len(goals), "firings")
        stamps = [stamp for ends in self._stamps.values() for stamp in ends]
        return max(stamps) - min(stamps)

    def _note(self, message: Firing) -> None:
        if message.net == "cell" and message.phase in (Firing.START, Firing.END):
            stamp = message.stamp.sec + message.stamp.nanosec * 1e-9
            self._stamps.setdefault(message.command_id, []).append(stamp)

    def _done(self, future: Any) -> Any:
        self._wait_for(future.done, "an answer of the dispatcher")
        return future.result()

    @staticmethod
    def _wait_for(ready: Any, what: str) -> None:
        deadline = clock.monotonic() + ANSWER_S
        while not ready():
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=what, seconds=ANSWER_S)
            clock.sleep(0.01)


def pair_lines(seeds: int, factor: float, port: int) -> list[Line]:
    """Start the machine; for each seed move each arm from home to a random place alone, then both at once.

    Raises:
        ImError: It does not start, or a move fails.
    """
    path = deployments.default_path()
    if start(deployments.load(path).with_values(clock_factor=factor, seed=1, port=port), path, START_S) != 0:
        raise StateError("the machine did not start")
    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        client = PairClient()
        with Spinner([client]):
            return [_line(client, seed) for seed in range(1, seeds + 1)]
    finally:
        rclpy.try_shutdown()
        stop.stop(say=lambda _: None)


def _line(client: PairClient, seed: int) -> Line:
    generator = np.random.default_rng(seed)
    cell = load_cell()
    lower, upper = cell.per_joint("limits.lower") + CLEAR, cell.per_joint("limits.upper") - CLEAR
    spread = np.tile(SPREAD, len(cell.groups))
    targets = np.clip(cell.home + generator.uniform(-spread, spread), lower, upper).reshape(len(cell.groups), -1)
    moves: list[tuple[str, Mapping[str, object]]] = [
        ("move", {"group": name, "joints": target.tolist()}) for name, target in zip(cell.groups, targets, strict=True)
    ]
    back: list[tuple[str, Mapping[str, object]]] = [("home", {"group": name}) for name in cell.groups]
    client.run(back)
    alone = [client.run([move]) for move in moves]
    client.run(back)
    together = client.run(moves)
    client.run(back)
    return Line(f"two moves at once, seed {seed}", together, "s", max(alone), "the longer one alone", bar=MOST)
