"""The web server of the display: one page, one websocket, any number of viewers."""

import asyncio
import errno
import socket
import threading
from typing import TYPE_CHECKING

from im_core.errors import LinkError
from im_pnt_display.page.hosts import is_everywhere
from im_pnt_display.page.state import Change, DisplayState
from im_pnt_display.page.viewers import Operate, Viewers

if TYPE_CHECKING:
    from im_pnt_display.page.recording import RecordedNets  # with the readers of bags

PORTS_TRIED = 20
_PORTS = 65536
_WAITING = 128
"""Most connections that wait to be taken."""


class DisplayServer:
    """Serves a display from a thread of its own.

    It listens at once, and loads the libraries of a web server when somebody comes first: mostly nobody does.

    Args:
        host: Address to listen on, 0.0.0.0 are all of IPv4 and :: all of IPv6; it answers to that name, to those of
            this computer for itself, and on all addresses to those of this computer for others.
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
        self._host, self._port, self._recording = host, port, recording
        self.state.operable = operate is not None
        self.state.recording = recording.overview if recording is not None else None
        self._operate, self._viewers = operate, Viewers(self.state)
        self._sockets: list[socket.socket] = []
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = "localhost" if is_everywhere(self._host) else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._port}/"

    def start(self) -> None:
        """Begins to serve.

        Raises:
            LinkError: No port is free.
        """
        self._listen()
        self._thread.start()

    def stop(self) -> None:
        """Ends all connections."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(timeout=5.0)

    def show(self, change: Change) -> None:
        """Passes a change of the state on to all viewers; from any thread."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._viewers.show, change)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()
            for listening in self._sockets:
                listening.close()

    async def _serve(self) -> None:
        come = asyncio.Event()
        for listening in self._sockets:
            self._loop.add_reader(listening, come.set)
        waits = [asyncio.ensure_future(event.wait()) for event in (come, self._stop)]
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        for wait in waits:
            wait.cancel()
        for listening in self._sockets:
            self._loop.remove_reader(listening)
        if not self._stop.is_set():
            from im_pnt_display.page.site import Site  # with the libraries

            site = Site(self._host, self._viewers, self._operate, self._recording)
            await site.serve(self._sockets, self._stop)

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


def _listening(host: str, port: int) -> list[socket.socket]:
    """Returns sockets that listen on all addresses of a name; the port of the first, if any will do.

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
