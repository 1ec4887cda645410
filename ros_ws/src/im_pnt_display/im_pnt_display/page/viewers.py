"""Viewers of the display, each with the changes still to be shown."""

import asyncio
import json
from collections.abc import Callable, Mapping

from im_pnt_display.page.state import Change, DisplayState

VIEWER_BACKLOG = 500

Operate = Callable[[Mapping[str, str]], None]
"""Takes what a viewer asks for: ``net``, ``request`` and ``argument``; called in the server's thread."""


class Viewers:
    """Viewers of a display; all but :attr:`state` for the loop of the server.

    Args:
        state: What is shown to whoever comes.
    """

    def __init__(self, state: DisplayState) -> None:
        self.state = state
        self._snapshot: str | None = None
        self._backlogs: dict[asyncio.Queue[str], None] = {}

    def __len__(self) -> int:
        return len(self._backlogs)

    def enter(self) -> asyncio.Queue[str]:
        """Enter a viewer; return the queue, with the state first."""
        backlog: asyncio.Queue[str] = asyncio.Queue(VIEWER_BACKLOG)
        backlog.put_nowait(self.snapshot_text())
        self._backlogs[backlog] = None
        return backlog

    def snapshot_text(self) -> str:
        """Return the state as JSON; the text is made once between two changes, for any number of viewers."""
        if self._snapshot is None:
            self._snapshot = json.dumps(self.state.snapshot())
        return self._snapshot

    def leave(self, backlog: asyncio.Queue[str]) -> None:
        """Remove a viewer."""
        del self._backlogs[backlog]

    def show(self, change: Change) -> None:
        """Make a change of the state, and pass the change on to all; a late viewer gets the state instead."""
        if not self.state.enter(change):
            return
        self._snapshot = None
        text = json.dumps(change) if self._backlogs else ""
        for backlog in self._backlogs:
            if backlog.full():
                while not backlog.empty():
                    backlog.get_nowait()
                backlog.put_nowait(self.snapshot_text())
            else:
                backlog.put_nowait(text)
