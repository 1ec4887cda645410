"""Puts and gets of small objects through :class:`im_core.ros.dom.DomClient`, beside bare services of the same types."""

import os
import sys
import tempfile
from array import array
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt8MultiArray

from bench.dom import bare
from bench.figures import Line
from bench.usage import cpu_s
from im_core import clock
from im_core.errors import WaitTimeoutError
from im_core.processes.process import ChildProcess
from im_core.ros import qos
from im_core.ros.calls import ask_again, call
from im_core.ros.dom import DomClient
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_msgs.srv import GetObject, PutObject

COUNT, IN_TURN, BYTES = 10_000, 1000, 100
ROUNDS = 5
"""``/dom`` and the bare service are asked in turn, so that what else the computer does is shared by both."""
NAMES = 100
BAR = 1.5
PATIENCE_S = 60.0

Call = Callable[[int], Coroutine[Any, Any, object]]


class _Client(ManagedNode):
    """Asks ``/dom`` through its client, and the bare services as a node without one does."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.dom = DomClient(self)
        self.bare_put = self.create_client(PutObject, bare.PUT, qos_profile=qos.QUEUED_SERVICE)
        self.bare_get = self.create_client(GetObject, bare.GET, qos_profile=qos.QUEUED_SERVICE)
        self._message = UInt8MultiArray(data=array("B", bytes(BYTES)))
        self._data = array("B", serialize_message(self._message))

    async def dom_puts(self, number: int) -> object:
        return await self.dom.put(f"bench/{number % NAMES}", self._message)

    async def dom_gets(self, number: int) -> object:
        return await self.dom.get(f"bench/{number % NAMES}", UInt8MultiArray)

    async def bare_puts(self, number: int) -> object:
        name = f"bench/{number % NAMES}"
        request = PutObject.Request(name=name, type=bare.KIND, data=self._data, source=self.task_name)
        return await self._bare(self.bare_put, request)

    async def bare_gets(self, number: int) -> object:
        return await self._bare(self.bare_get, GetObject.Request(name=f"bench/{number % NAMES}", type=bare.KIND))

    async def _bare(self, client: Any, request: object) -> object:
        promise = self.promise()
        client.call_async(request).add_done_callback(lambda future: promise.set_result(future.result()))
        return await promise

    def timed(self, ask: Call, flying: int, pids: tuple[int, ...]) -> tuple[float, float]:
        """Ask, so many at a time; wall and CPU time of a call, the processes' together [us]."""
        count = (COUNT if flying > 1 else IN_TURN) // ROUNDS
        left, ended = iter(range(count)), []

        async def some() -> None:
            for number in left:
                await ask(number)
            ended.append(True)

        before, began = sum(map(cpu_s, pids)), clock.monotonic()
        own = clock.cpu()
        for _ in range(flying):
            self.spawn(some())
        deadline = began + 10 * PATIENCE_S
        while len(ended) < flying:
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=f"{count} calls", seconds=10 * PATIENCE_S)
            clock.sleep(0.005)
        wall, cpu = clock.monotonic() - began, sum(map(cpu_s, pids)) - before + clock.cpu() - own
        return wall / count * 1e6, cpu / count * 1e6

    def until_ready(self) -> None:
        """Waits for the first answers; one that is given before all have discovered each other is lost.

        Raises:
            WaitTimeoutError: There are none.
        """
        done: list[bool] = []

        async def first() -> None:
            await self.dom_puts(0)
            for client, request in (
                (self.bare_put, PutObject.Request(name="bench/0")),
                (self.bare_get, GetObject.Request(name="bench/0")),
            ):
                await ask_again(partial(call, self, client, request, 2.0, "to be ready"), PATIENCE_S, "to be ready")
            done.append(True)

        self.spawn(first())
        deadline = clock.monotonic() + 3 * PATIENCE_S
        while not done:
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what="the first answers", seconds=3 * PATIENCE_S)
            clock.sleep(0.01)


def lines() -> list[Line]:
    """The figures: one client that waits for each answer, and one with 64 requests on their way.

    Raises:
        ImError: A process has died, or does not answer.
    """
    alone = ["--ros-args", "-p", "standalone:=true"]
    with tempfile.TemporaryDirectory(prefix="im_bench_") as folder:
        run_dir = {**os.environ, "IM_RUN_DIR": folder}
        servers = [
            ChildProcess(
                [sys.executable, "-m", module, *alone], log=Path(folder) / f"{module}.log", environment=run_dir
            )
            for module in ("im_dom.ros.node", "bench.dom.bare")
        ]
        rclpy.init(args=alone)
        try:
            putter, getter = _Client("bench_putter"), _Client("bench_getter")
            with spin_in_thread(putter, getter):
                for server in servers:
                    server.check()
                return _measured(putter, getter, (servers[0].pid, servers[1].pid))
        finally:
            rclpy.try_shutdown()
            for server in servers:
                server.stop()


def _measured(putter: _Client, getter: _Client, pids: tuple[int, int]) -> list[Line]:
    ways = {
        "put": (partial(putter.timed, putter.dom_puts), partial(putter.timed, putter.bare_puts)),
        "get": (partial(getter.timed, getter.dom_gets), partial(getter.timed, getter.bare_gets)),
    }
    for client in (putter, getter):
        client.until_ready()
    found = []
    for flying in (64, 1):
        for what, (dom, peer) in ways.items():
            wall, cpu, peer_wall, peer_cpu = np.mean(
                [(*dom(flying, pids[:1]), *peer(flying, pids[1:])) for _ in range(ROUNDS)], axis=0
            ).tolist()
            bar = BAR if flying > 1 else None
            text = f"{what}, {flying} on their way" if flying > 1 else f"{what}, one after the other"
            found.append(Line(f"{text}: wall", wall, "us", peer_wall, "bare", bar))
            found.append(Line(f"{text}: CPU", cpu, "us", peer_cpu, "bare", bar))
    return found
