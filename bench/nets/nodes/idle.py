"""A node whose actions all wait for something that does not come.

``python -m bench.nets.nodes.idle NAME FOLDER``
"""

import sys
from pathlib import Path

from rclpy.node import Node

from bench.nets.idle import TIMEOUT_S
from bench.nets.nodes.loop import alone, run, wait_until
from bench.nets.serving import Handler
from im_core.clock import cpu, sleep
from im_pnt.execution.events import TokenArrived
from im_pnt.execution.functions import ActionContext
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode

NET = """
net: {name}
rest: []
places: {{order: {{remote: true}}, done: }}
transitions:
  work: {{in: order, out: done, action: wait, on_failure: done, timeout: {timeout}}}
  leave: {{in: done}}
"""


class Waiting(PntNode):
    """Takes any number of orders, and waits in each."""

    def __init__(self, name: str, folder: Path) -> None:
        file = folder / f"{name}.yaml"
        file.write_text(NET.format(name=name, timeout=TIMEOUT_S), encoding="utf-8")
        super().__init__(name, [file], {"wait": self._wait}, verifier=verify_to_load, parameter_overrides=alone())

    async def _wait(self, ctx: ActionContext) -> None:
        promise = self.promise()
        ctx.on_cancel(lambda: promise.set_result(None))
        await promise

    def load(self, request: dict[str, object]) -> dict[str, object]:
        """Has so many actions begin."""
        wait_until(lambda: self.ready or bool(self.failed), f"{self.task_name} to be ready")
        actions = int(str(request["actions"]))
        executor = self.exchange.nets[self.task_name]
        for _ in range(actions):
            executor.post(TokenArrived("order", 1))
        wait_until(lambda: len(executor.activities) == actions, f"{actions} actions to run")
        return {"failed": self.failed}

    @staticmethod
    def rest(request: dict[str, object]) -> dict[str, object]:
        """Does nothing for a while; returns the CPU time that the process used meanwhile [s]."""
        seconds = float(str(request["seconds"]))
        began = cpu()
        sleep(seconds)
        return {"cpu_s": cpu() - began}


def _handlers(node: Node) -> dict[str, Handler]:
    assert isinstance(node, Waiting)
    return {"load": node.load, "rest": node.rest}


if __name__ == "__main__":
    task, path = sys.argv[1:]
    run(lambda: Waiting(task, Path(path)), _handlers)
