"""Figures of doing nothing: a thousand actions run, and nothing happens."""

import asyncio
import threading
from collections.abc import Coroutine
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from bench.figures import Line
from bench.nets.serving import serve
from bench.nets.workers import number, own
from im_core.clock import cpu, monotonic, sleep
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.runner import FunctionRunner
from im_pnt.model.action import FunctionAction
from im_pnt.model.net import Net, Place, Transition
from im_pnt_node.distributed.exchange import Exchange

ACTIONS = 1000
MOST_MS = 1.0
TIMEOUT_S = 3600.0
"""Time-out of the actions: something that could be waited for by looking again and again."""
_SETTLE_S = 1.0


def waiting_net(orders: int) -> Net:
    """A net with one transition whose action waits; it begins as often as there are orders."""
    places = {"order": Place("order", orders), "done": Place("done")}
    work = Transition(
        "work",
        inputs={"order": 1},
        outputs={"done": 1},
        action=FunctionAction("wait"),
        on_failure={"done": 1},
        timeout=TIMEOUT_S,
        origin="work",
    )
    return Net("waiting", places, {"work": work})


class Loop:
    """An executor in an event loop of its own, in a thread, without ROS."""

    def __init__(self, net: Net) -> None:
        self._loop = asyncio.new_event_loop()
        self._alarm_at: float | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        functions = Functions({"wait": self._wait})
        exchange = Exchange("bench", 1)
        runner = FunctionRunner(functions, exchange, self._spawn)
        self.executor = Executor(net, functions, runner, exchange, wake=self._wake)
        exchange.add(self.executor)
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        self._wake()

    def _wake(self) -> None:
        self._loop.call_soon_threadsafe(self._pump)

    def _pump(self) -> None:
        if self.executor.pump():
            self._wake()
        at = self.executor.next_wakeup()
        if at is not None and at != self._alarm_at:
            self._alarm_at = at
            self._loop.call_later(max(0.0, at - monotonic()), self._pump)

    def _spawn(self, work: Coroutine[object, object, None]) -> None:
        self._tasks.add(self._loop.create_task(work))

    async def _wait(self, ctx: ActionContext) -> None:
        await self._loop.create_future()


def lines(seconds: float, rounds: int, folder: Path) -> list[Line]:
    """CPU time of the core with a loop of its own, and of a node beyond the same node at rest.

    Args:
        seconds: Length of a round [s].
        rounds: Rounds; the median counts.
        folder: For net files.

    Raises:
        ImError: A process fails.
    """
    with ExitStack() as stack:
        core = stack.enter_context(own("bench.nets.idle"))
        core.ask("load", actions=ACTIONS)
        sleep(_SETTLE_S)
        used = [number(core.ask("rest", seconds=seconds), "cpu_s") for _ in range(rounds)]
    name = f"{ACTIONS} actions run, CPU in {seconds:g} s"
    return [Line(f"{name}, core", 1e3 * median(used), "ms", bar=MOST_MS), _of_nodes(name, seconds, rounds, folder)]


def _of_nodes(name: str, seconds: float, rounds: int, folder: Path) -> Line:
    module = "bench.nets.nodes.idle"
    used: dict[int, list[float]] = {ACTIONS: [], 0: []}
    with ExitStack() as stack:
        nodes = {
            actions: stack.enter_context(
                own(module, f"bench_idle_{actions}", str(folder), name=f"node with {actions} actions")
            )
            for actions in used
        }
        for actions, node in nodes.items():
            node.ask("load", actions=actions)
        sleep(_SETTLE_S)
        for _ in range(rounds):
            for node in nodes.values():
                node.tell("rest", seconds=seconds)
            for actions, node in nodes.items():
                used[actions].append(number(node.answer(), "cpu_s"))
    busy, idle = median(used[ACTIONS]), median(used[0])
    return Line(f"{name}, node beyond idle", 1e3 * (busy - idle), "ms", bar=MOST_MS)


def main() -> None:
    """Serves ``load`` (actions) and ``rest`` (seconds)."""
    loops: list[Loop] = []

    def load(request: dict[str, object]) -> dict[str, object]:
        actions = int(str(request["actions"]))
        loops.append(Loop(waiting_net(actions)))
        while len(loops[0].executor.activities) < actions:
            sleep(0.01)
        return {}

    def rest(request: dict[str, object]) -> dict[str, object]:
        began = cpu()
        sleep(float(str(request["seconds"])))
        return {"cpu_s": cpu() - began}

    serve({"load": load, "rest": rest})


if __name__ == "__main__":
    main()
