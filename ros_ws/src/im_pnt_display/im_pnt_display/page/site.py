"""The site of the display: the page, the state, moments of a recording, and a socket for each viewer."""

import asyncio
import hmac
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from aiohttp import WSMsgType, web

from im_core.clock import monotonic
from im_core.errors import DataError, ImError
from im_core.names import results_dir
from im_core.text.bounded_json import read_json
from im_pnt_display.page.doors import REQUEST_S, guarded_application
from im_pnt_display.page.state import Change
from im_pnt_display.page.viewers import VALUES, Operate, Viewer, Viewers

if TYPE_CHECKING:
    from im_pnt_display.page.recording import RecordedNets  # with the readers of bags

STATIC = Path(__file__).parent / "static"
VENDOR = Path(__file__).parent / "vendor"
READ_ONLY = (
    "this page only shows; where scripts/start.sh --control started the machine, scripts/im view prints the address of "
    "one that operates"
)
WRONG_TOKEN = "the token in the address is not that of this page; scripts/im view prints the right address"
RECORDED = "this page shows a recording; what happened is not changed"
MOST_VIEWERS = 100
MOST_CONNECTIONS = 150
"""Connections at a time, of viewers and others: each is an open file of a process that has more to do."""
_AT_ONCE = 16
"""Connections that are taken before the first of them is looked at."""
LONGEST_REQUEST = 10_000
"""Bytes of what a viewer asks for."""
VIEWER_PER_S, VIEWER_AT_ONCE = 10.0, 30
"""Messages of one viewer [1/s], and at once; a viewer that sends more is told so, and its connection ends."""
PAGE_PER_S, PAGE_AT_ONCE = 20.0, 50
"""Requests of all viewers [1/s], and at once, that are passed on to nets; the answer to others is :data:`TOO_MANY`."""
TOO_FAST = f"more than {VIEWER_PER_S:g} messages a second were sent; the connection ends"
TOO_MANY = f"viewers have asked for more than {PAGE_PER_S:g} things a second; this one is not done"
_TOLD_S = 0.5
"""Time in which a viewer that sends too much can read why its connection ends [s]."""


class Allowance:
    """Number of requests growing with time (token bucket); each request takes one away.

    Args:
        per_s: Growth [1/s].
        most: Largest number, which it begins with.
        now: Clock [s].
    """

    def __init__(self, per_s: float, most: int, now: Callable[[], float] = monotonic) -> None:
        self._per_s, self._most, self._now = per_s, most, now
        self._left, self._seen = float(most), now()

    def take_request(self) -> bool:
        """Take one away; returns whether one was left."""
        now = self._now()
        self._left = min(self._most, self._left + (now - self._seen) * self._per_s)
        self._seen = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Site:
    """Web site of the display, in the loop of the server.

    Args:
        host: Address that it is served on.
        viewers: Those who look.
        operate: Takes what viewers ask for; None: they only look.
        recording: What is shown in the place of running nets, to each viewer the moment that it asks for.
        token: The one in the address of whoever may operate.
    """

    def __init__(
        self,
        host: str,
        viewers: Viewers,
        operate: Operate | None = None,
        recording: "RecordedNets | None" = None,
        token: str = "",
    ) -> None:
        self._viewers, self._operate, self._recording, self._token = viewers, operate, recording, token
        self._stop = asyncio.Event()
        self._allowance = Allowance(PAGE_PER_S, PAGE_AT_ONCE)
        self._app = guarded_application(host)
        self._app.router.add_get("/", self._give_page)
        self._app.router.add_get("/state.json", self._give_state)
        self._app.router.add_get("/ws", self._view)
        self._app.router.add_get("/recording.json", self._give_moment)
        self._app.router.add_get("/cell.json", self._give_cell)
        self._app.router.add_get(r"/results/{folder:[\w-]+}/{picture:[\w-]+\.png}", _picture)
        for file in (*STATIC.iterdir(), *VENDOR.iterdir()):
            self._app.router.add_get(f"/static/{file.name}", partial(_file, file))

    async def serve(self, sockets: Sequence[socket.socket], stop: asyncio.Event) -> None:
        """Answer requests on listening sockets until the stop; all connections have ended then."""
        self._stop = stop
        runner = web.AppRunner(self._app, shutdown_timeout=1.0, keepalive_timeout=REQUEST_S)
        await runner.setup()
        server = runner.server
        assert server is not None, "it is set up"

        def protocol() -> asyncio.BaseProtocol:
            return server() if len(server.connections) < MOST_CONNECTIONS else _Refusal()

        loop = asyncio.get_running_loop()
        serving = [await loop.create_server(protocol, sock=each, backlog=_AT_ONCE) for each in sockets]
        await stop.wait()
        for each in serving:
            each.close()
        await runner.cleanup()

    def _may_operate(self, request: web.Request) -> bool:
        """Return whether a request has the token.

        Raises:
            HTTPForbidden: It has another one.
        """
        if (given := request.query.get("token")) is None:
            return False
        if not self._viewers.state.operable or not hmac.compare_digest(given.encode(), self._token.encode()):
            raise web.HTTPForbidden(text=WRONG_TOKEN)
        return True

    async def _give_page(self, request: web.Request) -> web.FileResponse:
        self._may_operate(request)
        return web.FileResponse(STATIC / "index.html")

    async def _give_state(self, request: web.Request) -> web.Response:
        return web.json_response(text=self._viewers.snapshot_text())

    async def _give_moment(self, request: web.Request) -> web.Response:
        with _complaints():
            return web.json_response(self._recorded().moment(request.query))

    async def _give_cell(self, request: web.Request) -> web.Response:
        with _complaints():  # a large bag takes a while
            return web.json_response(await asyncio.to_thread(self._recorded().cell, request.query))

    def _recorded(self) -> "RecordedNets":
        if self._recording is None:
            raise web.HTTPNotFound(text="this page shows a running machine, no recording")
        return self._recording

    async def _view(self, request: web.Request) -> web.WebSocketResponse:
        may_operate = self._may_operate(request)
        if len(self._viewers) >= MOST_VIEWERS:
            raise web.HTTPServiceUnavailable(text=f"{MOST_VIEWERS} pages are open already")
        socket = web.WebSocketResponse(heartbeat=20.0, max_msg_size=LONGEST_REQUEST, autoping=False, compress=False)
        await socket.prepare(request)
        viewer = self._viewers.enter()
        listener = asyncio.create_task(self._listen_to(socket, viewer, may_operate))
        works = [listener, *map(asyncio.ensure_future, (_send_to(socket, viewer), self._stop.wait()))]
        try:
            await asyncio.wait(works, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._viewers.leave(viewer)
            for work in works:
                work.cancel()
            await asyncio.gather(*works, return_exceptions=True)
            if listener.done() and not listener.cancelled() and listener.exception() is None and listener.result():
                await self._end_flood(request, socket)
            await socket.close()
        return socket

    async def _listen_to(self, socket: web.WebSocketResponse, viewer: Viewer, may_operate: bool) -> bool:
        """Take a message of a viewer; return whether the viewer has sent too much."""
        allowance = Allowance(VIEWER_PER_S, VIEWER_AT_ONCE)
        async for message in socket:
            if not allowance.take_request():
                return True
            if message.type is WSMsgType.PING:
                await socket.pong(message.data)
            elif message.type is WSMsgType.TEXT and (wanted := _wanted(message.data)) is not None:
                if wanted["request"] == "look":
                    self._viewers.look(viewer, at_cell=wanted["argument"] == "cell")
                elif refusal := self._refusal(may_operate or (self._recording is None and wanted["request"] == VALUES)):
                    await socket.send_json(_refused(wanted["net"], refusal))
                elif self._operate is not None:
                    self._operate(wanted)
        return False

    async def _end_flood(self, request: web.Request, socket: web.WebSocketResponse) -> None:
        """End the connection of a viewer sending too much; nothing more from the viewer is read."""
        transport = request.transport
        if transport is None:
            return
        transport.pause_reading()
        with suppress(OSError, TimeoutError):
            async with asyncio.timeout(_TOLD_S):
                await socket.send_json(_refused("page", TOO_FAST))
                await asyncio.sleep(_TOLD_S)
        transport.abort()

    def _refusal(self, may_operate: bool) -> str:
        """Return the reason for not passing on a request; empty for a request passed on."""
        if not may_operate:
            return READ_ONLY if self._recording is None else RECORDED
        return "" if self._allowance.take_request() else TOO_MANY


@contextmanager
def _complaints() -> Iterator[None]:
    """Answer an error of ours with the sentence."""
    try:
        yield
    except ImError as error:
        raise web.HTTPBadRequest(text=error.message) from error


class _Refusal(asyncio.Protocol):
    """Refusal of a connection beyond the largest number."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()


async def _send_to(socket: web.WebSocketResponse, viewer: Viewer) -> None:
    """Send a viewer the pieces; all viewers get the same bytes, not compressed."""
    while True:
        await socket.send_frame(await viewer.unsent.get(), WSMsgType.TEXT)


async def _file(path: Path, request: web.Request) -> web.FileResponse:
    return web.FileResponse(path)


async def _picture(request: web.Request) -> web.FileResponse:
    return web.FileResponse(results_dir() / request.match_info["folder"] / request.match_info["picture"])


def _refused(net: str, reason: str) -> Change:
    """Return the answer to a viewer with a refused request."""
    return {"kind": "answer", "net": net, "success": False, "message": reason}


def _wanted(text: str) -> Mapping[str, str] | None:
    """Return the request of a viewer, None for senseless text."""
    try:
        wanted = read_json(dict[str, str], text, "a request")
    except DataError:
        return None
    return wanted if {"net", "request", "argument"} <= wanted.keys() else None
