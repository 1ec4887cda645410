"""Viewers of the display, and the changes that go to all of them in one piece."""

import asyncio
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from im_core.clock import monotonic
from im_pnt_display.page.state import Change, DisplayState

GATHERED_S = 0.05
"""Shortest time between two pieces [s]."""
MOST_UNSENT = 100
"""Pieces that wait for a slow viewer; then it misses changes, and gets the state once these pieces are sent."""
END_OF_PIECE = b"\n\n"
"""Ends each piece on the link between two processes."""
VALUES = "values"
"""Request for the values behind a part of a net; whoever looks may ask."""

Operate = Callable[[Mapping[str, str]], None]
"""Takes what a viewer asks for: ``net``, ``request`` and ``argument``; called in the server's thread."""

Audience = Callable[[int, int], None]
"""Takes the numbers of viewers, and of viewers of the cell; called in the server's thread."""


@dataclass(eq=False, slots=True)
class Viewer:
    """Somebody who looks at the display.

    Attributes:
        at_cell: Whether it shows the cell, too.
        late: Whether changes are left out, until it can take the state instead.
        unsent: Pieces to be sent.
    """

    at_cell: bool = False
    late: bool = False
    unsent: asyncio.Queue[bytes] = field(default_factory=lambda: asyncio.Queue(MOST_UNSENT))


class Viewers:
    """Viewers of a display; all but :attr:`state` for the loop of the server.

    Changes that follow each other closely go in one piece, made once for all viewers: a line each, of a marking and of
    a part of the cell the newest alone.
    """

    def __init__(self, state: DisplayState, audience: Audience = lambda viewers, of_cell: None) -> None:
        self.state, self._audience = state, audience
        self._snapshot: str | None = None
        self._viewers: set[Viewer] = set()
        self._changes: dict[object, tuple[str, bool]] = {}
        self._due: asyncio.TimerHandle | None = None
        self._sent_s = -GATHERED_S

    def __len__(self) -> int:
        return len(self._viewers)

    def enter(self, *, at_cell: bool = False) -> Viewer:
        """Enter a viewer, also of the cell or not; the state comes first."""
        self.send()
        viewer = Viewer(at_cell)
        viewer.unsent.put_nowait(self.snapshot_text().encode())
        self._viewers.add(viewer)
        self._tell()
        return viewer

    def look(self, viewer: Viewer, *, at_cell: bool) -> None:
        """Begin or end to show a viewer the cell; the known parts of the cell come first."""
        if viewer.at_cell == at_cell:
            return
        self.send()
        viewer.at_cell = at_cell
        if parts := self._cell_text(viewer):
            self._put(viewer, parts.encode())
        self._tell()

    def snapshot_text(self) -> str:
        """Return the state as JSON; the text is made once between two changes, for any number of viewers."""
        if self._snapshot is None:
            self._snapshot = json.dumps(self.state.snapshot())
        return self._snapshot

    def leave(self, viewer: Viewer) -> None:
        """Remove a viewer."""
        self._viewers.discard(viewer)
        self._tell()

    def show(self, change: Change, text: str = "") -> None:
        """Make a change of the state, and pass the change on to all; a late viewer gets the state instead."""
        if not self.state.enter(change):
            return
        of_cell = change["kind"] == "cell"
        if not of_cell:
            self._snapshot = None
        if not self._viewers:
            return
        replaced = {"cell": change.get("part"), "marking": change.get("net")}.get(str(change["kind"]))
        key = object() if replaced is None else (of_cell, replaced)
        self._changes.pop(key, None)
        self._changes[key] = (text or json.dumps(change), of_cell)
        self._send_in(self._sent_s + GATHERED_S - monotonic())

    def relay(self, piece: bytes) -> None:
        """Show all changes of a piece that other viewers had gathered."""
        for line in piece.decode().split("\n"):
            self.show(json.loads(line), line)
        self.send()

    def send(self) -> None:
        """Send all viewers the unsent changes."""
        if self._due is not None:
            self._due.cancel()
            self._due = None
        changes, self._changes = self._changes.values(), {}
        self._sent_s = monotonic()
        pieces = {
            at_cell: "\n".join(lines).encode()
            for at_cell in {viewer.at_cell for viewer in self._viewers}
            if (lines := [line for line, of_cell in changes if at_cell or not of_cell])
        }
        for viewer in self._viewers:
            if viewer.late and viewer.unsent.empty():
                viewer.late = False
                parts = filter(None, (self.snapshot_text(), self._cell_text(viewer)))
                viewer.unsent.put_nowait("\n".join(parts).encode())
            elif not viewer.late and viewer.at_cell in pieces:
                self._put(viewer, pieces[viewer.at_cell])
        if any(viewer.late for viewer in self._viewers):
            self._send_in(GATHERED_S)

    def _put(self, viewer: Viewer, piece: bytes) -> None:
        if viewer.unsent.full():
            viewer.late = True
            self._send_in(GATHERED_S)
        else:
            viewer.unsent.put_nowait(piece)

    def _send_in(self, pause_s: float) -> None:
        if self._due is None:
            self._due = asyncio.get_running_loop().call_later(max(pause_s, 0.0), self.send)

    def _cell_text(self, viewer: Viewer) -> str:
        return "\n".join(map(json.dumps, self.state.cell_parts())) if viewer.at_cell else ""

    def _tell(self) -> None:
        self._audience(len(self._viewers), sum(viewer.at_cell for viewer in self._viewers))
