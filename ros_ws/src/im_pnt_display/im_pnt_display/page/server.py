"""The web server of the display: one page, one websocket, any number of viewers."""

import asyncio
import contextlib
import errno
import json
import secrets
import socket
import sys
import threading
from collections import deque
from collections.abc import Coroutine
from typing import TYPE_CHECKING

from im_core.errors import LinkError
from im_core.processes.process import ChildProcess
from im_core.text.bounded_json import read_json
from im_pnt_display.page.hosts import is_everywhere
from im_pnt_display.page.state import Change, DisplayState
from im_pnt_display.page.viewers import END_OF_PIECE, VALUES, Audience, Operate, Viewer, Viewers

if TYPE_CHECKING:
    from im_pnt_display.page.recording import RecordedNets  # with the readers of bags

PORTS_TRIED = 20
_PORTS = 65536
_WAITING = 128
"""Most connections that wait to be taken."""
WEB_PROCESS = "im_pnt_display.page.web_process"
_AGAIN_S = 3.0
"""Pause before a process that has ended is started again [s]."""
_UNSEEN_S = 0.2
"""Time in which changes are gathered while there are no viewers [s]."""
_END_S = 3.0
"""Time that the process has to end its connections [s]."""


class DisplayServer:
    """Server of a display, in a separate thread.

    It listens at once, and loads the libraries of a web server when somebody comes first: mostly nobody does.

    Args:
        host: Address to listen on, 0.0.0.0 are all of IPv4 and :: all of IPv6; it answers to that name, to those of
            this computer for itself, and on all addresses to those of this computer for others.
        port: Port; the next free one is taken where it is in use, any free one for 0.
        operate: Takes what viewers ask for; None: they only look.
        recording: What is shown in the place of running nets, to each viewer the moment that it asks for.
        apart: Whether a process of its own answers, which begins with the first visitor: viewers cannot slow this one.
        audience: Takes each change of the numbers of viewers.
        token: That of the address at which viewers may operate; empty: a new one.
        operable: Whether viewers with the token may have things done; if not, they only ask for values.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 8080,
        operate: Operate | None = None,
        recording: "RecordedNets | None" = None,
        apart: bool = False,
        audience: Audience = lambda viewers, of_cell: None,
        token: str = "",
        operable: bool = True,
    ) -> None:
        self.state = DisplayState()
        self._token, self._audience = token or secrets.token_urlsafe(16), audience
        self._host, self._port, self._recording, self._apart = host, port, recording, apart
        self.state.operable = operate is not None and operable
        self.state.recording = recording.overview if recording is not None else None
        self._operate = operate
        self._viewers = Viewers(self.state, _nobody if apart else audience)
        self._heard: deque[Change] = deque()
        self._woken = False
        self._sockets: list[socket.socket] = []
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = "localhost" if is_everywhere(self._host) else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._port}/"

    @property
    def address(self) -> str:
        """Address of the page, where viewers may operate with the token; a secret of this user."""
        return f"{self.url}?token={self._token}" if self.state.operable else self.url

    def start(self) -> None:
        """Begin to serve.

        Raises:
            LinkError: No port is free.
        """
        self._listen()
        self._thread.start()

    def stop(self) -> None:
        """End all connections."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(timeout=5.0)

    def show(self, change: Change) -> None:
        """Pass a change of the state on to all viewers; from any thread.

        To wake the server costs more than to note a change: it is woken once for all that comes until it looks.
        """
        if self._thread.is_alive():
            self._heard.append(change)
            if not self._woken:
                self._woken = True
                self._loop.call_soon_threadsafe(self._look)

    def _look(self) -> None:
        """Take the changes now for viewers, soon where there are none."""
        self._loop.call_later(0.0 if self._viewers else _UNSEEN_S, self._take)

    def _take(self) -> None:
        self._woken = False  # what comes from now on wakes the server again
        while self._heard:
            self._viewers.show(self._heard.popleft())

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()
            for listening in self._sockets:
                listening.close()

    async def _serve(self) -> None:
        while not self._stop.is_set() and await self._visited():
            if self._apart:
                await self._serve_apart()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stop.wait(), _AGAIN_S)
            else:
                from im_pnt_display.page.site import Site  # with the libraries

                site = Site(self._host, self._viewers, self._operate, self._recording, self._token)
                await site.serve(self._sockets, self._stop)

    async def _visited(self) -> bool:
        """Wait for a visitor; returns whether one came before the end."""
        come = asyncio.Event()
        for listening in self._sockets:
            self._loop.add_reader(listening, come.set)
        await _first(come.wait(), self._stop.wait())
        for listening in self._sockets:
            self._loop.remove_reader(listening)
        return not self._stop.is_set()

    async def _serve_apart(self) -> None:
        """Have a process answer visitors until the process or the display ends; the process counts as one viewer."""
        ours, its = socket.socketpair()
        given = [its.fileno(), *(listening.fileno() for listening in self._sockets)]
        with its:
            child = ChildProcess.of_module(WEB_PROCESS, [self._host, *map(str, given)], inherit=given)
        reader, writer = await asyncio.open_connection(sock=ours)
        writer.write(f"{self._token}\n".encode())
        viewer = self._viewers.enter(at_cell=True)
        try:
            await _first(self._take_requests(reader), _send_pieces(writer, viewer), self._stop.wait())
        finally:
            self._viewers.leave(viewer)
            self._audience(0, 0)
            writer.transport.abort()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
            if not child.await_end(_END_S):
                child.stop()
        if not self._stop.is_set():
            print(f"the page of the nets: {child.obituary()}; it begins again", file=sys.stderr)

    async def _take_requests(self, reader: asyncio.StreamReader) -> None:
        while line := await reader.readline():
            wanted = read_json(dict[str, str], line.decode(), "a request")
            if wanted["request"] == "audience":
                self._audience(*json.loads(wanted["argument"]))
            elif self._operate is not None and (self.state.operable or wanted["request"] == VALUES):
                self._operate(wanted)

    def _listen(self) -> None:
        first = self._port
        for port in range(first, min(first + PORTS_TRIED, _PORTS) if first else 1):
            try:
                self._sockets = _listening(self._host, port)
            except ValueError as error:  # as of a label that is too long
                raise LinkError(f"cannot serve the display on {self._host[:100]!r}: no name of a computer") from error
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise LinkError(f"cannot serve the display on {self._host}:{port}: {error.strerror}") from error
                continue
            self._port = int(self._sockets[0].getsockname()[1])
            return
        raise LinkError(f"cannot serve the display on {self._host}: ports {first} to {port} are all in use", port=first)


def _nobody(viewers: int, of_cell: int) -> None:
    """Pass over the number of processes that answer viewers."""


async def _send_pieces(writer: asyncio.StreamWriter, viewer: Viewer) -> None:
    """Send the process the pieces of a viewer."""
    with contextlib.suppress(ConnectionError):
        while True:
            writer.write(await viewer.unsent.get() + END_OF_PIECE)
            await writer.drain()


async def _first(*works: Coroutine[object, object, object]) -> None:
    """Wait until one of several works ends; the others are cancelled."""
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _listening(host: str, port: int) -> list[socket.socket]:
    """Return listening sockets on all addresses of a name; with the port of the first, if any port will do.

    Raises:
        OSError: One cannot.
    """
    sockets: list[socket.socket] = []
    found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    try:
        for family, kind, protocol, _, address in dict.fromkeys(found):
            sockets.append(socket.socket(family, kind, protocol))
            sockets[-1].setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                sockets[-1].setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            sockets[-1].bind((address[0], port or sockets[0].getsockname()[1], *address[2:]))
            sockets[-1].setblocking(False)
            sockets[-1].listen(_WAITING)
    except OSError:
        for listening in sockets:
            listening.close()
        raise
    return sockets
