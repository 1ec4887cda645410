"""State of a display: nets, markings, last firings, commands, and the cell; as plain data."""

from collections import deque
from collections.abc import Mapping
from typing import Any

from im_pnt.model.net import Net
from im_pnt_display.drawing.draw import draw

FIRINGS_KEPT = 300
LOG_KEPT = 300
REFUSALS_KEPT = 20
#: Parts of the cell: anybody may publish markers.
MOST_CELL_PARTS = 200

Change = dict[str, object]
"""What is passed on to viewers, by its ``kind``; JSON data:

- ``net``: a new net or a new structure, with ``net``, ``node`` and what :func:`net_content` returns; a former refusal
  of the name is over. ``gone``: ``net`` is unloaded. ``refusal``: of ``net``, with its counterexample.
- ``marking``: of ``net``, with ``tokens`` by place, ``active``, ``cancelling`` and ``in_doubt`` transitions, the
  ``sequence`` number of the firing after which it holds, ``mode``, ``paused``, and ``proposed`` transitions.
- ``firing``: as of :func:`im_pnt_display.page.messages.firing_content`. ``breakpoints``: by net, of a ``node``.
- ``mcs``: ``state``, ``reason``, ``power``, ``brakes``, states of reserved ``groups``, the reason of a
  ``protective_stop``, owners of ``stopped`` groups, and whether all that is ``stale``.
- ``commands``: all ``content`` of a ``part``: ``known``, ``listed``, ``ended`` or ``diagnostics``. ``log``: new
  ``lines``: time [s since 1970], level, node and text of each.
- ``cell``, for viewers of the cell alone: all ``content`` of a ``part``: ``robot``, ``joints``, ``frame/<name>``,
  ``marker/<namespace>/<id>``, ``image/<camera>`` or ``spot/<camera>``; None: the part has gone.
- ``answer`` to a viewer's request (``net``, ``success``, ``message``), and ``values`` behind a ``part`` of ``net`` are
  passed on without being kept.
"""


def net_content(net: Net) -> dict[str, object]:
    """Return the structure and drawings of a net, as JSON data.

    ``usual`` is the drawing with subnets folded, and without what tokens reach only after a failure or a
    cancellation; None where that is all.
    """
    drawing, usual = draw(net, subnets=True), draw(net, usual=True)
    return {
        "net": net.name,
        "description": net.description,
        "symbols": net.symbols(),
        "services": sorted(net.services),
        "drawing": drawing.to_dict(),
        "usual": usual.to_dict() if len(usual.nodes) < len(drawing.nodes) else None,
    }


class DisplayState:
    """Last known state of every net; :meth:`enter` makes a change.

    Attributes:
        operable: Whether viewers may operate nets.
        recording: What is to be known of the recording that is shown; None: running nets are.
    """

    def __init__(self) -> None:
        self._nets: dict[str, Mapping[str, object]] = {}
        self._markings: dict[str, Change] = {}
        self._refusals: dict[str, Change] = {}
        self._firings: deque[Change] = deque(maxlen=FIRINGS_KEPT)
        self._mcs: Change | None = None
        self._commands: dict[str, Change] = {}
        self._breakpoints: dict[str, Change] = {}
        self._log: deque[object] = deque(maxlen=LOG_KEPT)
        self._cell: dict[str, Change] = {}
        self.operable = False
        self.recording: Mapping[str, object] | None = None

    def enter(self, change: Change) -> bool:
        """Make a change, in the thread of the snapshots; return whether the state changed."""
        net = str(change.get("net"))
        match change["kind"]:
            case "snapshot":
                self._restore(change)
            case "net":
                self._refusals.pop(net, None)
                self._nets[net] = {name: value for name, value in change.items() if name != "kind"}
            case "gone":  # its firings stay among the last ones
                for known in (self._nets, self._markings, self._refusals):
                    known.pop(net, None)
            case "marking":
                self._markings[net] = change
            case "refusal":  # the last ones are kept
                self._refusals.pop(net, None)
                self._refusals[net] = change
                if len(self._refusals) > REFUSALS_KEPT:
                    del self._refusals[next(iter(self._refusals))]
            case "firing":
                self._firings.append(change)
            case "breakpoints":
                self._breakpoints[str(change["node"])] = change
            case "log":
                lines = change["lines"]
                assert isinstance(lines, list)
                self._log.extend(lines)
            case "mcs":
                if change == self._mcs:
                    return False
                self._mcs = change
            case "commands":
                if change == self._commands.get(part := str(change["part"])):
                    return False
                self._commands[part] = change
            case "cell":
                part = str(change["part"])
                if part not in self._cell and len(self._cell) >= MOST_CELL_PARTS:
                    return False
                self._cell[part] = change
        return True

    def _restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take the state returned by :meth:`snapshot` of another process."""
        self._nets = {net["net"]: net for net in snapshot["nets"]}
        self._markings = {marking["net"]: marking for marking in snapshot["markings"]}
        self._refusals = {refusal["net"]: refusal for refusal in snapshot["refusals"]}
        self._firings = deque(snapshot["firings"], maxlen=FIRINGS_KEPT)
        self._mcs, self.operable, self.recording = (snapshot[key] for key in ("mcs", "operable", "recording"))
        self._breakpoints = {change["node"]: change for change in snapshot["breakpoints"]}
        self._log = deque(snapshot["log"], maxlen=LOG_KEPT)
        self._commands = {change["part"]: change for change in snapshot["commands"]}

    def cell_parts(self) -> list[Change]:
        """Return the known parts of the cell, for a new viewer of the cell."""
        return [change for change in self._cell.values() if change["content"] is not None]

    def snapshot(self) -> Change:
        """Return the whole state but for the cell, for a new viewer."""
        return {
            "kind": "snapshot",
            "nets": [self._nets[name] for name in sorted(self._nets)],
            "markings": list(self._markings.values()),
            "refusals": list(self._refusals.values()),
            "firings": list(self._firings),
            "mcs": self._mcs,
            "commands": list(self._commands.values()),
            "breakpoints": list(self._breakpoints.values()),
            "log": list(self._log),
            "operable": self.operable,
            "recording": self.recording,
        }
