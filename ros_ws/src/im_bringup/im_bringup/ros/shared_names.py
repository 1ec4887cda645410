"""Names served by two nodes, one being a node of the machine: either node may answer."""

from collections.abc import Collection

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from im_core import clock
from im_core.ros import qos
from im_core.ros.failures import few
from im_core.ros.guard import GuardedNode
from im_core.ros.heartbeats import LEASE_S
from im_core.ros.messages.stamps import wall_stamp
from im_core.ros.peers.client_identity import UNKNOWN_NODE
from im_core.ros.peers.servers import servers_of

#: How often the graph is looked at [s].
LOOK_S = 5.0
#: Two nodes of one name may be one that was killed and the one in its place, for as long as the lease and a look [s].
#: The graph may have forgotten the name of a killed one.
_SUCCESSION_S = LEASE_S + 2.0 * LOOK_S


class SharedNames:
    """Search for services and actions of the machine served by a second node; report on ``/diagnostics``.

    Args:
        node: The bootstrap's.
        nodes: Full names of the nodes of the machine.
    """

    def __init__(self, node: GuardedNode, nodes: Collection[str]) -> None:
        self._node, self._nodes = node, frozenset(nodes)
        self._since: dict[str, float] = {}
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
        #: One sentence for each node of the machine that does not serve alone, by its name.
        self.sentences: dict[str, str] = {}

    def look(self) -> bool:
        """Look at the graph; whether anything changed."""
        served = (name for name, _ in self._node.get_service_names_and_types() if self._node.count_services(name) > 1)
        doubled = {name: servers for name in served if len(servers := servers_of(self._node, name)) > 1}
        now = clock.monotonic()
        self._since = {name: self._since.get(name, now) for name in doubled}
        by_servers: dict[tuple[str, ...], list[str]] = {}
        for name, servers in sorted(doubled.items()):
            if (
                len({server for server in servers if UNKNOWN_NODE not in server}) > 1
                or now - self._since[name] > _SUCCESSION_S
            ):
                by_servers.setdefault(tuple(servers), []).append(name)
        sentences = {
            server: f"{len(servers)} nodes serve {few(served)}: {few(servers)}; which of them answers is chance"
            for servers, served in by_servers.items()
            for server in servers
            if server in self._nodes
        }
        changed, self.sentences = sentences != self.sentences, sentences
        if sentences or changed:
            self._tell(sentences)
        return changed

    def _tell(self, sentences: dict[str, str]) -> None:
        level = DiagnosticStatus.WARN if sentences else DiagnosticStatus.OK
        words = " / ".join(sentences.values()) or "each name is served once"
        name = self._node.get_name()
        status = DiagnosticStatus(level=level, name=f"{name}: served names", hardware_id=name, message=words)
        message = DiagnosticArray(status=[status])
        message.header.stamp = wall_stamp()
        self._publisher.publish(message)
