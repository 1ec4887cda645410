"""State of a display: nets, markings, last firings, commands, and the cell; as plain data."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from im_pnt.model.net import Net
from im_pnt_display.drawing.draw import draw

FIRINGS_KEPT = 300
LOG_KEPT = 300
REFUSALS_KEPT = 20
#: Parts of the cell: anybody may publish markers.
MOST_CELL_PARTS = 200

Change = dict[str, object]


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
    """Last known state of every net. Most methods return a change; :meth:`enter` makes the change, in the shown state.

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

    def net(self, name: str, node: str, content: Mapping[str, object]) -> Change:
        """Return the change for a new net or a new structure; a former refusal of the name is over."""
        return {"kind": "net", "net": name, "node": node, **content}

    def gone(self, name: str) -> Change:
        """Return the change for an unloaded net."""
        return {"kind": "gone", "net": name}

    def marking(self, net: str, marking: Mapping[str, object]) -> Change:
        """Return the change for the marking of a net, and the mode of operation.

        Args:
            net: Name of the net.
            marking: ``tokens`` by place, ``active``, ``cancelling`` and ``in_doubt`` transitions, ``sequence`` number
                of the firing after which it holds, ``mode``, ``paused``, and ``proposed`` transitions.
        """
        return {"kind": "marking", "net": net, **marking}

    def refusal(self, net: str, refusal: Mapping[str, object]) -> Change:
        """Return the change for the refusal of a net, with the counterexample."""
        return {"kind": "refusal", "net": net, **refusal}

    def answer(self, net: str, success: bool, message: str) -> Change:
        """Return the answer to a viewer's request, for passing on without keeping."""
        return {"kind": "answer", "net": net, "success": success, "message": message}

    def firing(self, firing: Mapping[str, object]) -> Change:
        """Return the change for a firing."""
        return {"kind": "firing", **firing}

    def motion_control(self, condition: Mapping[str, object]) -> Change:
        """Return the change for the state of the Motion Control System.

        Args:
            condition: ``state``, ``reason``, ``power``, ``brakes``, states of reserved ``groups``, the reason of a
                ``protective_stop``, owners of ``stopped`` groups, and whether all that is ``stale``.
        """
        return {"kind": "mcs", **condition}

    def commands(self, part: str, content: object) -> Change:
        """Return the change for a part of the state of commands.

        Args:
            part: ``known``, ``listed``, ``ended`` or ``diagnostics``.
            content: All of the part, as JSON data.
        """
        return {"kind": "commands", "part": part, "content": content}

    def breakpoints(self, node: str, breakpoints: Mapping[str, Sequence[str]]) -> Change:
        """Return the change for the breakpoints of a node's nets: transitions by net."""
        return {"kind": "breakpoints", "node": node, "breakpoints": breakpoints}

    def log(self, lines: Sequence[object]) -> Change:
        """Return the change for new lines of the log: time [s since 1970], level, node and text of each."""
        return {"kind": "log", "lines": lines}

    def values(self, net: str, part: str, content: object) -> Change:
        """Return the values behind a part of a net, for passing on without keeping."""
        return {"kind": "values", "net": net, "part": part, "content": content}

    def cell(self, part: str, content: object) -> Change:
        """Return the change for a part of the cell, for viewers of the cell alone.

        Args:
            part: ``robot``, ``joints``, ``frame/<name>``, ``marker/<namespace>/<id>``, ``image/<camera>`` or
                ``spot/<camera>``.
            content: All of the part, as JSON data; None: the part has gone.
        """
        return {"kind": "cell", "part": part, "content": content}

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
