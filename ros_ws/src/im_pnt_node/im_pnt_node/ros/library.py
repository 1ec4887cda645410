"""The nets of a node and the known ones of others, the verification together, and the replacement.

A net that is loaded at run time is verified, alone and together, then takes its place when the present one is at rest.
"""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from im_core.clock import monotonic
from im_core.errors import ImError, NotFoundError, StateError
from im_core.files import make_folder, write_whole
from im_core.ros import qos
from im_core.ros.calls import pause, run_in_thread
from im_core.ros.node import ManagedNode
from im_core.ros.qos import MOST_NETS
from im_msgs.msg import NetDescription
from im_pnt.description import read_net
from im_pnt.errors import NetError, VerificationError
from im_pnt.execution.executor import Executor
from im_pnt.model.groups import group_of, nets_by_name
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, yaml_text
from im_pnt.verification import Verification, Verifier, accept
from im_pnt_node.journal.journal import fingerprint
from im_pnt_node.journal.state import net_state
from im_pnt_node.ros.reporting.publish import PntPublisher

REST_CHECK_S = 0.02
#: What has come to a net is taken in its next turn; so long that is waited for, by who has no patience, too [s].
TURN_S = 2.0

#: How long it may take to read a net [s].
READ_S = 60.0
#: Files of nets that came later are kept so many: of those that run, and the newest; journals set aside may name them.
MOST_KEPT = 100


class Library:
    """Finds and verifies nets.

    Args:
        files: Net files that the node begins with.
        verifier: Says whether nets may run together.
    """

    def __init__(self, files: Sequence[Path], verifier: Verifier) -> None:
        self._files, self._verifier = list(files), verifier
        self._kept: Path | None = None
        self._known: dict[str, Net] = {}
        self._nodes: dict[str, str] = {}
        self._unread: dict[tuple[str, str], NetDescription] = {}
        self._reading = False

    def begin_with(self, files: Sequence[Path]) -> None:
        """Set the first net files of the node."""
        self._files = list(files)

    def keep_in(self, folder: Path) -> None:
        """Keep later nets in a folder for a restart of the node."""
        self._kept = make_folder(folder)

    def follow(self, node: ManagedNode) -> None:
        """Learn the nets of other nodes; the reading may take seconds, and the loop goes on meanwhile."""
        self._node = node
        node.create_subscription(NetDescription, "/pnt/nets", self._learn, qos.LATCHED_NETS)

    def nets(self, found: Mapping[str, str]) -> list[Net]:
        """Load the first nets.

        Args:
            found: The nets of the journal, with the files they came from; empty: those the node was made with.

        Raises:
            NetFileError: A file is not a net.
            NetError: Two files have nets of the same name.
        """
        files = [Path(source) for source in found.values()] if found else self._files
        return list(nets_by_name(map(load_net, files)).values())

    def kept(self, net: Net) -> Net:
        """Write a net down, if nets are kept; return the net with the new source."""
        if self._kept is None:
            return net
        path = self._kept / f"{net.name}-{fingerprint(net)}.yaml"
        write_whole(path, yaml_text(net))
        return replace(net, source=str(path))

    def tidy(self, nets: Iterable[Net]) -> None:
        """Remove the oldest kept files beyond the largest number.

        Args:
            nets: The nets that run, which the journal names; their files stay.
        """
        if self._kept is None:
            return
        used = {Path(net.source) for net in nets}
        with contextlib.suppress(OSError):  # the next time is early enough
            files = sorted(self._kept.glob("*.yaml"), key=lambda file: file.stat().st_mtime)
            for file in files[: max(0, len(files) - MOST_KEPT)]:
                if file not in used:
                    file.unlink()

    def group(self, net: Net, own: Sequence[Net]) -> list[Net]:
        """Return a net with all known direct and indirect partners.

        Args:
            net: The net.
            own: Nets of this node.
        """
        return group_of(net, list({**self._known, **{each.name: each for each in own}}.values()))

    def with_servers(self, net: Net, own: Sequence[Net]) -> list[Net]:
        """Return a net with the known direct and indirect receivers of the requests and tokens.

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

    def verify(self, nets: Sequence[Net]) -> Verification:
        """Verify nets, alone or composed.

        Raises:
            NetError: They do not fit together.
        """
        return self._verifier(nets)

    def _learn(self, description: NetDescription) -> None:
        key = description.net, description.node
        if len(self._unread) == MOST_NETS and key not in self._unread:
            raise NetError(f"it is not read: {MOST_NETS} others wait", net=description.net)
        self._unread.pop(key, None)  # read is in the order in which it was told
        self._unread[key] = description
        if not self._reading:
            self._reading = True
            self._node.spawn(self._read())

    async def _read(self) -> None:
        """Read the descriptions of nets, the last one of each node for each net."""
        while self._unread:
            net, node = key = next(iter(self._unread))
            told = self._unread.pop(key)
            if not told.json:
                self._forget(net, node)
                continue
            try:
                self._enter(await run_in_thread(self._node, read_net, net, told.json, node, timeout_s=READ_S), node)
            except ImError as error:
                self._forget(net, node)
                self._node.note_failure("subscription /pnt/nets", error, lambda: "im_msgs/msg/NetDescription")
        self._reading = False

    def _enter(self, net: Net, node: str) -> None:
        if len(self._known) == MOST_NETS and net.name not in self._known:
            raise NetError(f"net {net.name} is not learned: {MOST_NETS} others are known", net=net.name)
        self._known[net.name], self._nodes[net.name] = net, node

    def _forget(self, net: str, node: str) -> None:
        """Remove a net no longer on the node; another node may have taken the net over."""
        if self._nodes.get(net) == node:
            del self._known[net], self._nodes[net]


class Loader:
    """Loader of nets: verifies a net, and waits until the net may take the place.

    Args:
        node: The node.
        library: Knows the other nets.
        nets: Those of the node by name; looked at anew for each net.
        publisher: Shows why a net was refused.
    """

    def __init__(
        self, node: ManagedNode, library: Library, nets: Mapping[str, Executor], publisher: PntPublisher
    ) -> None:
        self._node, self._library, self._nets, self._publisher = node, library, nets, publisher

    async def prepare(
        self, net: Net, patience_s: float, beside: Sequence[Net] = ()
    ) -> tuple[Verification, dict[str, object] | None]:
        """Verify a net, alone and with the partners, and wait until the present net of the name is at rest.

        Args:
            net: The net.
            patience_s: Longest wait for that [s].
            beside: Nets that take the places of those of their names in the same turn.

        Returns:
            The report, and the state that it takes over, if any; the net is to take its place at once.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: It does not fit to the present marking.
            StateError: The present net of that name does not come to rest; says what keeps it.
        """
        report = await self.verified(net, beside)
        present = self._nets.get(net.name)
        if present is None:
            return report, None
        await self._until_rest(present, patience_s)
        context = carried_over(present, net)
        if context is net:
            return report, None
        report = await self.verified(context, beside)
        await self._until_rest(present, patience_s)
        if carried_over(present, net) != context:
            raise StateError(f"net {net.name} went on while its successor was verified; load it again")
        return report, net_state(present)

    async def until_it_may_go(self, name: str, patience_s: float, beside: Sequence[Net] = ()) -> None:
        """Wait until a net may be taken out.

        Args:
            name: Its name.
            patience_s: Longest wait for it to come to rest [s].
            beside: Nets that take the places of those of their names in the same turn.

        Raises:
            NotFoundError: There is none of that name.
            StateError: Another net asks it, or it does not come to rest; says what keeps it.
        """
        if name not in self._nets:
            raise NotFoundError(kind="net", name=name, known=self._nets)
        left = {net: each.written for net, each in self._nets.items() if net != name}
        left |= {each.name: each for each in beside}
        asking = [net for net, each in left.items() if name in each.partners()]
        if asking:
            raise StateError(f"net {name} cannot go: {', '.join(asking)} asks it", net=name, askers=asking)
        await self._until_rest(self._nets[name], patience_s)

    async def verified(self, net: Net, beside: Sequence[Net] = (), without: str = "") -> Verification:
        """Verify a net, alone and with the partners.

        Args:
            net: The net.
            beside: Nets that take the places of those of their names.
            without: Net of this node that will have gone.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: They do not fit together.
        """
        own = {name: executor.written for name, executor in self._nets.items() if name != without}
        own |= {each.name: each for each in beside}
        together = [each for each in self._library.group(net, list(own.values())) if each.name != without]
        alone = await self.verified_alone(net)
        if len(together) == 1:
            return alone
        composed = await self._accepted(net, together)
        return alone if alone.unproved else composed

    async def verified_alone(self, net: Net) -> Verification:
        """Verify a net alone: faults of the net show with the shortest sequence, and soon.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: It does not fit together.
        """
        return await self._accepted(net, [net])

    async def _accepted(self, net: Net, nets: Sequence[Net]) -> Verification:
        report = await run_in_thread(self._node, self._library.verify, nets)
        try:
            accept(report)
        except VerificationError as error:
            self._publisher.refused(net.name, error.message, report.composed, report.refusals)
            raise
        return report

    async def _until_rest(self, executor: Executor, patience_s: float) -> None:
        began = monotonic()
        while not (rest := executor.at_rest()):
            if monotonic() - began > (max(patience_s, TURN_S) if executor.due else patience_s):
                name = executor.net.name
                text = f"net {name} is not at rest and cannot be replaced now: {rest}"
                raise StateError(text, net=name, reasons=list(rest.reasons))
            await pause(self._node, REST_CHECK_S)


def carried_over(executor: Executor, net: Net) -> Net:
    """Return a net with the tokens of the resting predecessor; unchanged where no token of the predecessor has moved.

    Raises:
        NetError: A place that is marked is not in the new net.
    """
    marking = executor.marking()
    if marking == executor.net.initial_marking():
        return net
    structure = executor.net.places.keys() - executor.written.places.keys()
    missing = [f"{place}={count}" for place, count in marking.items() if place not in {*net.places, *structure}]
    if missing:
        raise NetError(
            f"net {net.name} cannot take the place of the present one, which holds {', '.join(missing)}: "
            "it has no such place",
            net=net.name,
        )
    places = {
        name: replace(place, tokens=marking.get(name, 0)) if name in executor.net.places else place
        for name, place in net.places.items()
    }
    return replace(net, places=places)
