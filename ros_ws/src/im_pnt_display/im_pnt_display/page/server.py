"""The web server of the display: one page, one websocket, any number of viewers."""

import asyncio
import errno
import json
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from aiohttp import WSMsgType, web

from im_core.arrivals import read_json
from im_core.errors import DataError, ImError, LinkError, WaitTimeoutError
from im_core.startup import patience_s
from im_pnt_display.page.doors import REQUEST_S, guarded_application
from im_pnt_display.page.state import Change, DisplayState

if TYPE_CHECKING:
    from im_pnt_display.page.recording import RecordedNets  # with the readers of bags

STATIC = Path(__file__).parent / "static"
VIEWER_BACKLOG = 500
PORTS_TRIED = 20
READ_ONLY = "this page only shows; scripts/start.sh --control lets it operate nets"
RECORDED = "this page shows a recording; what happened is not changed"
MOST_VIEWERS = 100
LONGEST_REQUEST = 10_000
"""Bytes of what a viewer asks for."""

Operate = Callable[[Mapping[str, str]], None]
"""Takes what a viewer asks for: ``net``, ``request`` and ``argument``; called in the server's thread."""


class DisplayServer:
    """Serves a display from a thread of its own.

    Args:
        host: Address to listen on; it answers to that name, and to those of this computer for itself.
        port: Port; the next free one is taken where it is in use, any free one for 0.
        operate: Takes what viewers want done with nets; None: they only look.
        recording: What is shown in the place of running nets, to each viewer the moment that it asks for.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 8080,
        operate: Operate | None = None,
        recording: "RecordedNets | None" = None,
    ) -> None:
        self.state = DisplayState()
        self._host, self._port, self._operate, self._recording = host, port, operate, recording
        self.state.operable = operate is not None
        self.state.recording = recording.overview if recording is not None else None
        self._viewers: dict[asyncio.Queue[str], None] = {}
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._ready = threading.Event()
        self._failure: ImError | None = None
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = "localhost" if self._host in ("", "0.0.0.0", "::") else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._port}/"

    def start(self) -> None:
        """Begins to serve.

        Raises:
            LinkError: No port is free.
            WaitTimeoutError: The server does not come up.
        """
        self._thread.start()
        if not self._ready.wait(wait_s := patience_s()):
            raise WaitTimeoutError(what="the display server", seconds=wait_s)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Ends all connections."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(timeout=5.0)

    def show(self, change: Change) -> None:
        """Passes a change of the state on to all viewers; from any thread."""
        text = json.dumps(change)
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._broadcast, text)

    def _broadcast(self, text: str) -> None:
        for backlog in self._viewers:
            if backlog.full():
                while not backlog.empty():
                    backlog.get_nowait()
                backlog.put_nowait(json.dumps(self.state.snapshot()))
            else:
                backlog.put_nowait(text)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        app = guarded_application(self._host)
        app.router.add_get("/", _page)
        app.router.add_get("/state.json", self._give_state)
        app.router.add_get("/ws", self._view)
        app.router.add_get("/recording.json", self._give_moment)
        app.router.add_static("/static", STATIC)
        runner = web.AppRunner(app, shutdown_timeout=1.0, keepalive_timeout=REQUEST_S)
        await runner.setup()
        try:
            await self._listen(runner)
        except ImError as error:
            self._failure = error
            return
        finally:
            self._ready.set()
        await self._stop.wait()
        await runner.cleanup()

    async def _listen(self, runner: web.AppRunner) -> None:
        first = self._port
        for port in range(first, first + PORTS_TRIED if first else 1):
            site = web.TCPSite(runner, self._host, port)
            try:
                await site.start()
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise LinkError(f"cannot serve the display on {self._host}:{port}: {error.strerror}") from error
                await site.stop()
                continue
            self._port = int(runner.addresses[0][1])
            return
        raise LinkError(f"cannot serve the display on {self._host}: ports {first} to {port} are all in use", port=first)

    async def _give_state(self, request: web.Request) -> web.Response:
        return web.json_response(self.state.snapshot())

    async def _give_moment(self, request: web.Request) -> web.Response:
        if self._recording is None:
            raise web.HTTPNotFound(text="this page shows running nets, no recording")
        try:
            return web.json_response(self._recording.moment(request.query))
        except ImError as error:
            raise web.HTTPBadRequest(text=error.message) from error

    async def _view(self, request: web.Request) -> web.WebSocketResponse:
        if len(self._viewers) >= MOST_VIEWERS:
            raise web.HTTPServiceUnavailable(text=f"{MOST_VIEWERS} pages are open already")
        socket = web.WebSocketResponse(heartbeat=20.0, max_msg_size=LONGEST_REQUEST)
        await socket.prepare(request)
        backlog: asyncio.Queue[str] = asyncio.Queue(VIEWER_BACKLOG)
        backlog.put_nowait(json.dumps(self.state.snapshot()))
        self._viewers[backlog] = None
        sender = asyncio.create_task(_pass_on(backlog, socket))
        stopper = asyncio.create_task(self._stop.wait())
        listener = asyncio.create_task(self._listen_to(socket))
        try:
            await asyncio.wait({sender, stopper, listener}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            del self._viewers[backlog]
            for task in (sender, stopper, listener):
                task.cancel()
            await asyncio.gather(sender, stopper, listener, return_exceptions=True)
            await socket.close()
        return socket

    async def _listen_to(self, socket: web.WebSocketResponse) -> None:
        async for message in socket:
            if message.type in (WSMsgType.CLOSE, WSMsgType.ERROR):
                return
            if message.type is WSMsgType.TEXT and (wanted := _wanted(message.data)) is not None:
                if self._operate is not None:
                    self._operate(wanted)
                else:
                    why = READ_ONLY if self._recording is None else RECORDED
                    self.show(self.state.answer(wanted["net"], False, why))


async def _page(request: web.Request) -> web.FileResponse:
    return web.FileResponse(STATIC / "index.html")


async def _pass_on(backlog: asyncio.Queue[str], socket: web.WebSocketResponse) -> None:
    while True:
        await socket.send_str(await backlog.get())


def _wanted(text: str) -> Mapping[str, str] | None:
    """Returns what a viewer asks for, None if it makes no sense; text that no message can carry makes none."""
    try:
        wanted = read_json(dict[str, str], text, "a request")
    except DataError:
        return None
    return wanted if {"net", "request", "argument"} <= wanted.keys() else None
