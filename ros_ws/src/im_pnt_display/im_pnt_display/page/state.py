"""What a display shows: nets, their markings, and the last firings; as plain data."""

from collections import deque
from collections.abc import Mapping

from im_pnt.model.net import Net
from im_pnt_display.drawing.draw import draw

FIRINGS_KEPT = 300
REFUSALS_KEPT = 20

Change = dict[str, object]


def net_content(net: Net) -> dict[str, object]:
    """Returns the structure and drawing of a net, as JSON data."""
    return {
        "net": net.name,
        "description": net.description,
        "symbols": net.symbols(),
        "services": sorted(net.services),
        "drawing": draw(net).to_dict(),
    }


class DisplayState:
    """The last known state of every net; each method returns the change to pass on to viewers.

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
        self.operable = False
        self.recording: Mapping[str, object] | None = None

    def net(self, name: str, node: str, content: Mapping[str, object]) -> Change:
        """Enters a net, or its new structure; that one of its name was refused before is over.

        Args:
            name: Name of the net.
            node: Node that runs it.
            content: Its description, with the drawing.
        """
        self._refusals.pop(name, None)
        self._nets[name] = {"net": name, "node": node, **content}
        return {"kind": "net", **self._nets[name]}

    def gone(self, name: str) -> Change:
        """Takes out a net that was unloaded; its firings stay among the last ones."""
        self._nets.pop(name, None)
        self._markings.pop(name, None)
        self._refusals.pop(name, None)
        return {"kind": "gone", "net": name}

    def marking(self, net: str, marking: Mapping[str, object]) -> Change:
        """Enters the marking of a net, and how it is operated.

        Args:
            net: Name of the net.
            marking: ``tokens`` by place, ``active``, ``cancelling`` and ``in_doubt`` transitions, ``sequence`` number
                of the firing after which it holds, ``mode``, ``paused``, and ``proposed`` transitions.
        """
        change: Change = {"kind": "marking", "net": net, **marking}
        self._markings[net] = change
        return change

    def refusal(self, net: str, refusal: Mapping[str, object]) -> Change:
        """Enters that a net was refused, with the counterexample; the last ones are kept."""
        change: Change = {"kind": "refusal", "net": net, **refusal}
        self._refusals.pop(net, None)
        self._refusals[net] = change
        if len(self._refusals) > REFUSALS_KEPT:
            del self._refusals[next(iter(self._refusals))]
        return change

    def answer(self, net: str, success: bool, message: str) -> Change:
        """Returns the answer to what a viewer asked for; it is passed on and not kept."""
        return {"kind": "answer", "net": net, "success": success, "message": message}

    def firing(self, firing: Mapping[str, object]) -> Change:
        """Enters a firing."""
        change: Change = {"kind": "firing", **firing}
        self._firings.append(change)
        return change

    def motion_control(self, condition: Mapping[str, object]) -> Change | None:
        """Enters what the Motion Control System says of itself, None if that is nothing new.

        Args:
            condition: ``state``, ``reason``, ``power``, ``brakes``, states of reserved ``groups``, and whether all that
                is ``stale``.
        """
        change: Change = {"kind": "mcs", **condition}
        if change == self._mcs:
            return None
        self._mcs = change
        return change

    def snapshot(self) -> Change:
        """Returns everything, for a viewer that begins."""
        return {
            "kind": "snapshot",
            "nets": [self._nets[name] for name in sorted(self._nets)],
            "markings": list(self._markings.values()),
            "refusals": list(self._refusals.values()),
            "firings": list(self._firings),
            "mcs": self._mcs,
            "operable": self.operable,
            "recording": self.recording,
        }
