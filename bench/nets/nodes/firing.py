"""A node that fires a ring with guards and actions, with its journal; and another that listens, as the display does.

``python -m bench.nets.nodes.firing fire|show FOLDER``
"""

import sys
import threading
from pathlib import Path

from rclpy.node import Node

from bench.nets.families import ACTION
from bench.nets.nodes.loop import PATIENCE_S, alone, run, wait_until
from bench.nets.player import GUARD, OVER, SYMBOL, Work, working
from bench.nets.serving import Handler
from im_core.clock import cpu
from im_core.ros import qos
from im_msgs.msg import Firing
from im_pnt.execution.events import GuardsChanged
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Command
from im_pnt.netfile import yaml_text
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode

PLACES = 100
TOPIC = "/pnt/firings"


class Firer(PntNode):
    """Fires while it is told to."""

    def __init__(self, folder: Path) -> None:
        self._net = working("ring", PLACES, Work.ALL)
        file = folder / "bench_ring.yaml"
        file.write_text(yaml_text(self._net), encoding="utf-8")
        super().__init__(
            "bench_firer",
            [file],
            {ACTION: self._count},
            {GUARD: self._more, OVER: lambda _: False},
            verifier=verify_to_load,
            parameter_overrides=alone(journal_dir=str(folder / "journal")),
        )
        self._left = 0
        self._done = threading.Event()

    def _count(self, _: ActionContext) -> None:
        self._left -= 1

    def _more(self, _: ActionContext) -> bool:
        if self._left <= 0:
            self._done.set()
        return self._left > 0

    def await_ready(self, request: dict[str, object]) -> dict[str, object]:
        """Waits until the net runs and is listened to by so many subscribers."""
        subscribers = int(str(request["subscribers"]))
        wait_until(lambda: self.ready or bool(self.failed), f"{self.task_name} to be ready")
        wait_until(lambda: self.count_subscribers(TOPIC) >= subscribers, f"{subscribers} subscribers")
        return {"failed": self.failed}

    def fire(self, request: dict[str, object]) -> dict[str, object]:
        """Fires so often; returns the CPU time that the process used [s]."""
        firings = int(str(request["firings"]))
        self._done.clear()
        began = cpu()
        self._left = firings
        executor = self.exchange.nets[self._net.name]
        if executor.busy():
            executor.post(GuardsChanged())
        else:
            executor.command(Command(1, SYMBOL))
        finished = self._done.wait(PATIENCE_S)
        return {"finished": finished, "firings": firings, "cpu_s": cpu() - began, "sequence": executor.sequence}


class Listener(Node):
    """Counts the firings that it is told of."""

    def __init__(self) -> None:
        super().__init__("bench_display")
        self._heard = 0
        self.create_subscription(Firing, TOPIC, self._hear, qos.EVENTS)

    def _hear(self, _: Firing) -> None:
        self._heard += 1

    def heard(self, _: dict[str, object]) -> dict[str, object]:
        """Returns how many it was told of; of those that come too fast, the middleware keeps the last."""
        return {"heard": self._heard}


def _handlers(node: Node) -> dict[str, Handler]:
    if isinstance(node, Firer):
        return {"ready": node.await_ready, "fire": node.fire}
    assert isinstance(node, Listener)
    return {"heard": node.heard}


if __name__ == "__main__":
    role, path = sys.argv[1:]
    run(Listener if role == "show" else lambda: Firer(Path(path)), _handlers)
