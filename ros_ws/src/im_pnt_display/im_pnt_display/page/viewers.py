"""Viewers of the display, each with the changes still to be shown."""

import asyncio
import json
from collections.abc import Callable, Mapping

from im_pnt_display.page.state import Change, DisplayState

VIEWER_BACKLOG = 500
VALUES = "values"
"""Request for the values behind a part of a net; whoever looks may ask."""

Operate = Callable[[Mapping[str, str]], None]
"""Takes what a viewer asks for: ``net``, ``request`` and ``argument``; called in the server's thread."""

Audience = Callable[[int, int], None]
"""Takes the numbers of viewers, and of viewers of the cell; called in the server's thread."""


class Viewers:
    """Viewers of a display; all but :attr:`state` for the loop of the server.

    Args:
        state: What is shown to whoever comes.
        audience: Takes each change of the numbers of viewers.
    """

    def __init__(self, state: DisplayState, audience: Audience = lambda viewers, of_cell: None) -> None:
        self.state = state
        self._audience = audience
        self._snapshot: str | None = None
        self._backlogs: dict[asyncio.Queue[str], bool] = {}

    def __len__(self) -> int:
        return len(self._backlogs)

    def enter(self, *, of_cell: bool = False) -> asyncio.Queue[str]:
        """Enter a viewer, also of the cell or not; return the queue, with the state first."""
        backlog: asyncio.Queue[str] = asyncio.Queue(VIEWER_BACKLOG)
        backlog.put_nowait(self.snapshot_text())
        self._backlogs[backlog] = of_cell
        self._tell()
        return backlog

    def look(self, backlog: asyncio.Queue[str], *, at_cell: bool) -> None:
        """Begin or end to show a viewer the cell; the known parts of the cell come first."""
        if self._backlogs[backlog] == at_cell:
            return
        self._backlogs[backlog] = at_cell
        if at_cell:
            for change in self.state.cell_parts():
                self._pass_on(backlog, json.dumps(change))
        self._tell()

    def snapshot_text(self) -> str:
        """Return the state as JSON; the text is made once between two changes, for any number of viewers."""
        if self._snapshot is None:
            self._snapshot = json.dumps(self.state.snapshot())
        return self._snapshot

    def leave(self, backlog: asyncio.Queue[str]) -> None:
        """Remove a viewer."""
        del self._backlogs[backlog]
        self._tell()

    def show(self, change: Change) -> None:
        """Make a change of the state, and pass the change on to all; a late viewer gets the state instead."""
        if not self.state.enter(change):
            return
        of_cell = change["kind"] == "cell"
        if not of_cell:
            self._snapshot = None
        viewers = [backlog for backlog, at_cell in self._backlogs.items() if at_cell or not of_cell]
        text = json.dumps(change) if viewers else ""
        for backlog in viewers:
            self._pass_on(backlog, text)

    def _pass_on(self, backlog: asyncio.Queue[str], text: str) -> None:
        if backlog.full():
            while not backlog.empty():
                backlog.get_nowait()
            backlog.put_nowait(self.snapshot_text())
            if self._backlogs[backlog]:
                for change in self.state.cell_parts():
                    backlog.put_nowait(json.dumps(change))
        else:
            backlog.put_nowait(text)

    def _tell(self) -> None:
        self._audience(len(self._backlogs), sum(self._backlogs.values()))
