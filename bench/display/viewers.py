"""CPU time of the process that answers viewers of the page."""

import asyncio
from pathlib import Path

import aiohttp

from bench.display.firing_net import shown_firing
from bench.figures import Line
from bench.usage import cpu_s, program
from im_core import clock
from im_core.errors import ImError
from im_pnt_display.page.server import WEB_PROCESS

VIEWERS = 20
_SETTLED_S = 3.0
_PATIENCE_S = 60.0


def lines(seconds: float) -> list[Line]:
    """Share of a core, for a large net that fires often, and a small one.

    Raises:
        ImError: A viewer heard nothing.
    """
    return [
        Line(f"{VIEWERS} viewers, {places} places, {per_s:g}/s", _share(rings, length, per_s, seconds), "%", bar=5.0)
        for rings, length, per_s in ((25, 40, 500.0), (4, 12, 20.0))
        for places in (f"{rings * length:,}",)
    ]


def _share(rings: int, length: int, per_s: float, seconds: float) -> float:
    """CPU time of the process of the page over wall time [%]."""
    with shown_firing(rings, length, per_s) as server:
        return asyncio.run(_watched(f"{server.url}ws", seconds))


async def _watched(address: str, seconds: float) -> float:
    heard = [0] * VIEWERS

    async def view(session: aiohttp.ClientSession, number: int) -> None:
        async with session.ws_connect(address, compress=15, max_msg_size=0) as viewer:  # as browsers ask for
            async for _ in viewer:
                heard[number] += 1

    async with aiohttp.ClientSession() as session, asyncio.TaskGroup() as group:
        viewing = [group.create_task(view(session, number)) for number in range(VIEWERS)]
        async with asyncio.timeout(_PATIENCE_S):
            while not all(heard):
                await asyncio.sleep(0.1)
        await asyncio.sleep(_SETTLED_S)
        (pid,) = (child for child in _children() if program(child) == WEB_PROCESS)
        before, used, began = list(heard), cpu_s(pid), clock.monotonic()
        await asyncio.sleep(seconds)
        share = 100.0 * (cpu_s(pid) - used) / (clock.monotonic() - began)
        if silent := sum(now == then for now, then in zip(heard, before, strict=True)):
            raise ImError(f"{silent} of {VIEWERS} viewers have heard nothing while they were measured")
        for each in viewing:
            each.cancel()
    return share


def _children() -> list[int]:
    """Children of this process."""
    tasks = Path("/proc/self/task").iterdir()
    return [int(word) for task in tasks for word in (task / "children").read_text(encoding="ascii").split()]
