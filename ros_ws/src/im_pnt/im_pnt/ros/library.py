"""The nets that a node runs, those that it knows of, and whether they may run together."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from im_core.files import write_whole
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_msgs.msg import NetDescription
from im_pnt.analysis.reachability import Limits
from im_pnt.analysis.report import Report
from im_pnt.analysis.verify import verify
from im_pnt.errors import NetFileError
from im_pnt.journal.fingerprint import fingerprint
from im_pnt.net import Net
from im_pnt.netfile import load_net, parse_net
from im_pnt.netfile.writer import yaml_text

LOAD_LIMITS = Limits(states=2_000_000, seconds=20.0)


class Library:
    """Finds and verifies nets.

    Args:
        files: Net files that the node begins with.
    """

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = list(files)
        self._kept: Path | None = None
        self._known: dict[str, Net] = {}

    def keep_in(self, folder: Path) -> None:
        """Has nets that came later kept in a folder, where a node that died finds them."""
        folder.mkdir(parents=True, exist_ok=True)
        self._kept = folder

    def follow(self, node: ManagedNode) -> None:
        """Learns the nets of other nodes."""
        node.create_subscription(NetDescription, "/pnt/nets", self._learn, qos.LATCHED_MANY)

    def nets(self, found: Mapping[str, str]) -> list[Net]:
        """Loads the nets to begin with.

        Args:
            found: The nets of the journal, with the files they came from; empty: those the node was made with.

        Raises:
            NetFileError: A file is not a net.
        """
        files = [Path(source) for source in found.values()] if found else self._files
        return [load_net(file) for file in files]

    def kept(self, net: Net) -> Net:
        """Writes a net down, if nets are kept; returns it with its new source."""
        if self._kept is None:
            return net
        path = self._kept / f"{net.name}-{fingerprint(net)}.yaml"
        write_whole(path, yaml_text(net))
        return replace(net, source=str(path))

    def partners(self, net: Net, own: Sequence[Net]) -> list[Net]:
        """Returns the nets that a net talks to, or that talk to it, as far as they are known.

        Args:
            net: The net.
            own: Nets of this node.
        """
        known = {**self._known, **{each.name: each for each in own}}
        return [
            other
            for name, other in known.items()
            if name != net.name and (name in net.partners() or net.name in other.partners())
        ]

    def with_servers(self, net: Net, own: Sequence[Net]) -> list[Net]:
        """Returns a net with those that it asks or sends tokens to, and so on, as far as they are known.

        Args:
            net: The net.
            own: Nets of this node.
        """
        known = {**self._known, **{each.name: each for each in own}}
        together = {net.name: net}
        waiting = [net]
        while waiting:
            for name in sorted(waiting.pop().partners() - together.keys()):
                if name in known:
                    together[name] = known[name]
                    waiting.append(known[name])
        return list(together.values())

    def verify(self, nets: Sequence[Net]) -> Report:
        """Verifies nets, alone or composed.

        Raises:
            NetError: They do not fit together.
        """
        return verify(nets, LOAD_LIMITS)

    def _learn(self, description: NetDescription) -> None:
        try:
            self._known[description.net] = parse_net(json.loads(description.json)["yaml"], description.node)
        except (KeyError, TypeError, ValueError, NetFileError):  # another kind of node; its net is then unknown
            self._known.pop(description.net, None)
