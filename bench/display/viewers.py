"""CPU time of the process that answers viewers of the page."""

import asyncio
import os

import aiohttp

from bench.display.firing_net import shown_firing
from bench.figures import Line
from bench.usage import children, cpu_s, program
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
    found = []
    for rings, length, per_s in ((25, 40, 500.0), (4, 12, 20.0)):
        with shown_firing(rings, length, per_s) as server:
            share, told_per_s = asyncio.run(_watched(f"{server.url}ws", seconds))
        name = f"{VIEWERS} viewers, {rings * length:,} places, {per_s:g}/s"
        found.append(Line(name, share, "%", None, f"of a core; {told_per_s:.3g} messages a second to each", bar=5.0))
    return found


async def _watched(address: str, seconds: float) -> tuple[float, float]:
    """CPU time of the process of the page over wall time [%], and messages to a viewer [1/s]."""
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
        (pid,) = (child for child in children(os.getpid()) if program(child) == WEB_PROCESS)
        before, used, began = list(heard), cpu_s(pid), clock.monotonic()
        await asyncio.sleep(seconds)
        took_s = clock.monotonic() - began
        share, told = 100.0 * (cpu_s(pid) - used) / took_s, (sum(heard) - sum(before)) / VIEWERS / took_s
        if silent := sum(now == then for now, then in zip(heard, before, strict=True)):
            raise ImError(f"{silent} of {VIEWERS} viewers have heard nothing while they were measured")
        for each in viewing:
            each.cancel()
    return share, told
