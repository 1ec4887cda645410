"""Net files of a node, and the known nets of other nodes."""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from im_core.errors import ImError
from im_core.files import make_folder, write_whole
from im_core.ros import qos
from im_core.ros.calls import run_in_thread
from im_core.ros.coroutines import OneAtATime
from im_core.ros.node import ManagedNode
from im_core.ros.qos import MOST_NETS
from im_msgs.msg import NetDescription
from im_pnt.description import read_net
from im_pnt.errors import NetError
from im_pnt.model.groups import group_of, nets_by_name
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, load_present, yaml_text
from im_pnt.verification import Verifier
from im_pnt_node.journal.journal import fingerprint

#: How long it may take to read a net [s].
READ_S = 60.0
#: Files of nets that came later are kept so many: of those that run, and the newest; journals set aside may name them.
MOST_KEPT = 100


class Library:
    """Finds and verifies nets.

    Attributes:
        files: As given.
        verify: As given.
        left_out: Why nets of files are not loaded: the cell lacks what they need; by name of the file.
        changed: Nets of the journal whose files are not there any more as they were.
        newer: Nets of the files that a person gave, where the journal has others of their names.
    """

    def __init__(self, files: Sequence[Path], verifier: Verifier) -> None:
        self.files, self.verify = list(files), verifier
        self.left_out: dict[str, str] = {}
        self.changed: list[str] = []
        self.newer: list[Net] = []
        self._kept: Path | None = None
        self._known: dict[str, Net] = {}
        self._nodes: dict[str, str] = {}
        self._unread: dict[tuple[str, str], NetDescription] = {}

    def keep_in(self, folder: Path) -> None:
        """Keep later nets in a folder for a restart of the node."""
        self._kept = make_folder(folder)

    def follow(self, node: ManagedNode, own: Callable[[], Iterable[Net]]) -> None:
        """Learn the nets of other nodes; the reading may take seconds, and the loop goes on meanwhile.

        Args:
            node: The node.
            own: Returns the nets that run there; of others only their partners are read before :meth:`read`.
        """
        self._node, self._own, self._readers = node, own, OneAtATime(node.promise)
        node.create_subscription(NetDescription, "/pnt/nets", self._learn, qos.LATCHED_NETS)

    def nets(self, found: Mapping[str, tuple[str, str]], typed: bool) -> list[Net]:
        """Load the first nets, without those that need more parts than the cell has.

        A mission goes on with its nets as they were: of a file that has changed since, with the one that was kept.

        Args:
            found: The nets of the journal, with the files they came from, and their fingerprints; empty: those the node
                was made with.
            typed: Whether a person gave the files with this start.

        Raises:
            NetFileError: A file is not a net.
            NetError: Two files have nets of the same name.
        """
        files = [self._as_it_was(name, *known) for name, known in found.items()] if found else self.files
        for file in self.files if found and typed else ():
            with contextlib.suppress(ImError):  # no net any more, or gone: the mission goes on without the file
                self._compare(load_net(file), found)
        nets, self.left_out = load_present(files)
        nets = [replace(net, source=found[net.name][0]) if net.name in self.changed else net for net in nets]
        return list(nets_by_name(nets).values())

    def _compare(self, net: Net, found: Mapping[str, tuple[str, str]]) -> None:
        """Note a net of a file where the journal has another of the name, and that was not loaded later."""
        if net.name in found:
            source, known_by = found[net.name]
            if fingerprint(net) != known_by and Path(source).name != self._place(net.name, known_by).name:
                self.newer.append(net)

    def keep(self, nets: Iterable[Net]) -> None:
        """Keep nets as they are, for a mission that outlives their files.

        Raises:
            StoreError: They cannot be written.
        """
        for net in nets:
            if self._kept is not None and not (path := self._place(net.name, fingerprint(net))).exists():
                write_whole(path, yaml_text(net))

    def _place(self, name: str, known_by: str) -> Path:
        assert self._kept is not None
        return self._kept / f"{name}-{known_by}.yaml"

    def _as_it_was(self, name: str, source: str, known_by: str) -> Path:
        """Return the file of a net of the journal; the kept one if the other has changed."""
        file, kept = Path(source), self._place(name, known_by)
        if file == kept or not kept.exists():
            return file
        with contextlib.suppress(ImError):  # no net any more, or gone
            if fingerprint(load_net(file)) == known_by:
                return file
        self.changed.append(name)
        return kept

    def kept(self, net: Net) -> Net:
        """Write a net down, if nets are kept; return the net with the new source, one of a given file with its own."""
        if self._kept is None:
            return net
        path = self._place(net.name, fingerprint(net))
        write_whole(path, yaml_text(net))
        return net if net in self.newer else replace(net, source=str(path))

    def tidy(self, nets: Iterable[Net]) -> None:
        """Remove the oldest kept files beyond the largest number.

        Args:
            nets: The nets that run, which the journal names; their files stay.
        """
        if self._kept is None:
            return
        used = {self._place(net.name, fingerprint(net)) for net in nets}
        with contextlib.suppress(OSError):  # the next time is early enough
            files = sorted(self._kept.glob("*.yaml"), key=lambda file: file.stat().st_mtime)
            for file in files[: max(0, len(files) - MOST_KEPT)]:
                if file not in used:
                    file.unlink()

    def group(self, net: Net, own: Sequence[Net]) -> list[Net]:
        """Return a net with all direct and indirect partners that :meth:`read` has read."""
        return group_of(net, list({**self._known, **{each.name: each for each in own}}.values()))

    def with_servers(self, net: Net, own: Sequence[Net]) -> list[Net]:
        """Return a net with the known direct and indirect receivers of the requests and tokens."""
        known = {**self._known, **{each.name: each for each in own}}
        together = {net.name: net}
        waiting = [net]
        while waiting:
            for name in sorted(waiting.pop().partners() - together.keys()):
                if name in known:
                    together[name] = known[name]
                    waiting.append(known[name])
        return list(together.values())

    def _learn(self, description: NetDescription) -> None:
        key = description.net, description.node
        if description.node == self._node.get_fully_qualified_name():
            return
        if len(self._unread) == MOST_NETS and key not in self._unread:
            raise NetError(f"it is not read: {MOST_NETS} others wait", net=description.net)
        self._unread.pop(key, None)  # read is in the order in which it was told
        self._unread[key] = description
        if self._is_needed(key):
            self._node.spawn(self.read(self._is_needed))

    def _is_needed(self, key: tuple[str, str]) -> bool:
        """Return whether a description is of a known net, or of a direct or indirect partner."""
        partners = (net.partners() for net in (*self._own(), *self._known.values()))
        return not self._unread[key].json or key[0] in self._known or any(key[0] in names for names in partners)

    async def read(self, chosen: Callable[[tuple[str, str]], bool] = lambda key: True) -> None:
        """Read the descriptions of nets, the last one of each node for each net.

        Args:
            chosen: Tells by net and node whether to read a description now.
        """
        async with self._readers:
            while (key := next(filter(chosen, self._unread), None)) is not None:
                (net, node), told = key, self._unread.pop(key)
                if not told.json:
                    self._forget(net, node)
                    continue
                try:
                    found = await run_in_thread(self._node, read_net, net, told.json, node, timeout_s=READ_S)
                    self._enter(found, node)
                except ImError as error:
                    self._forget(net, node)
                    self._node.note_failure("subscription /pnt/nets", error, lambda: "im_msgs/msg/NetDescription")

    def _enter(self, net: Net, node: str) -> None:
        if net.former:
            return
        if len(self._known) == MOST_NETS and net.name not in self._known:
            raise NetError(f"net {net.name} is not learned: {MOST_NETS} others are known", net=net.name)
        self._known[net.name], self._nodes[net.name] = net, node

    def _forget(self, net: str, node: str) -> None:
        """Remove a net no longer on the node; another node may have taken the net over."""
        if self._nodes.get(net) == node:
            del self._known[net], self._nodes[net]
