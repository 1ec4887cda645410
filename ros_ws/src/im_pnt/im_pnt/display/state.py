"""What a display shows: nets, their markings, and the last firings; as plain data."""

from collections import deque
from collections.abc import Mapping

FIRINGS_KEPT = 300

Change = dict[str, object]


class DisplayState:
    """The last known state of every net; each method returns the change to pass on to viewers."""

    def __init__(self) -> None:
        self._nets: dict[str, Mapping[str, object]] = {}
        self._markings: dict[str, Change] = {}
        self._firings: deque[Change] = deque(maxlen=FIRINGS_KEPT)

    def net(self, name: str, node: str, content: Mapping[str, object]) -> Change:
        """Enters a net, or its new structure.

        Args:
            name: Name of the net.
            node: Node that runs it.
            content: Its description, with the drawing.
        """
        self._nets[name] = {"net": name, "node": node, **content}
        return {"kind": "net", **self._nets[name]}

    def marking(self, net: str, tokens: Mapping[str, int], active: list[str], sequence: int) -> Change:
        """Enters the marking of a net.

        Args:
            net: Name of the net.
            tokens: Marked places.
            active: Transitions whose action runs.
            sequence: Number of the firing after which it holds.
        """
        change: Change = {
            "kind": "marking",
            "net": net,
            "tokens": dict(tokens),
            "active": active,
            "sequence": sequence,
        }
        self._markings[net] = change
        return change

    def firing(self, firing: Mapping[str, object]) -> Change:
        """Enters a firing."""
        change: Change = {"kind": "firing", **firing}
        self._firings.append(change)
        return change

    def snapshot(self) -> Change:
        """Returns everything, for a viewer that begins."""
        return {
            "kind": "snapshot",
            "nets": [self._nets[name] for name in sorted(self._nets)],
            "markings": list(self._markings.values()),
            "firings": list(self._firings),
        }
