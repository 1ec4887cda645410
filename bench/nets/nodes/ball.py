"""Remote tokens: two nets in two processes send one token back and forth, each with its journal.

``python -m bench.nets.nodes.ball ping|pong IDLE_SUBSCRIPTIONS FOLDER``
"""

import sys
import threading
from itertools import pairwise
from pathlib import Path

from rclpy.node import Node

from bench.nets.nodes.loop import PATIENCE_S, alone, run, wait_until
from bench.nets.serving import Handler
from im_core.clock import cpu, monotonic
from im_pnt.execution.events import GuardsChanged
from im_pnt.execution.functions import ActionContext
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode

NETS = {
    "ping": """
net: bench_ping
rest: []
places: {ball: {remote: true}, held: 1}
transitions:
  serve: {in: held, out: [bench_pong.ball], guard: playing}
  hit: {in: ball, out: [bench_pong.ball], guard: playing}
  hold: {in: ball, out: held, guard: not playing}
""",
    "pong": """
net: bench_pong
rest: []
places: {ball: {remote: true}}
transitions:
  hit: {in: ball, out: [bench_ping.ball]}
""",
}


class Side(PntNode):
    """One of the two nodes; plays as soon as it is ready, while its guard says so.

    Args:
        side: ``ping`` or ``pong``.
        folder: Where the net file and the journal go.
    """

    def __init__(self, side: str, folder: Path) -> None:
        file = folder / f"bench_{side}.yaml"
        file.write_text(NETS[side], encoding="utf-8")
        super().__init__(
            f"bench_{side}",
            [file],
            guards={"playing": self._playing},
            verifier=verify_to_load,
            parameter_overrides=alone(journal_dir=str(folder / "journal")),
        )
        self._trips = 0
        self._times: list[float] = []
        self._last = -1
        self._done = threading.Event()

    def _playing(self, _: ActionContext) -> bool:
        """Notes when the token is here, once for each arrival."""
        if not self._trips:
            return False
        sequence = self.exchange.nets["bench_ping"].sequence
        if sequence != self._last:
            self._last = sequence
            self._times.append(monotonic())
            if len(self._times) > self._trips:
                self._trips = 0
                self._done.set()
        return bool(self._trips)

    def await_ready(self, _: dict[str, object]) -> dict[str, object]:
        """Waits until the nets run."""
        wait_until(lambda: self.ready or bool(self.failed), f"{self.task_name} to be ready")
        return {"failed": self.failed}

    def play(self, request: dict[str, object]) -> dict[str, object]:
        """Makes round trips; returns how long each took [s]."""
        self._done.clear()
        began = cpu()
        self._times, self._last = [], -1
        self._trips = int(str(request["trips"]))
        self.exchange.nets["bench_ping"].post(GuardsChanged())
        finished = self._done.wait(PATIENCE_S)
        times = self._times
        return {
            "finished": finished,
            "trips_s": [later - earlier for earlier, later in pairwise(times)],
            "cpu_s": cpu() - began,
        }


def _handlers(node: Node) -> dict[str, Handler]:
    assert isinstance(node, Side)
    return {"ready": node.await_ready, "play": node.play}


if __name__ == "__main__":
    name, subscriptions, path = sys.argv[1:]
    run(lambda: Side(name, Path(path)), _handlers, int(subscriptions))
