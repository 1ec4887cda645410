"""Descriptions of nets, and the nodes behind the descriptions."""

from collections.abc import Mapping

from im_core.errors import NotFoundError

#: Nodes whose descriptions of one net are kept: anybody may describe it.
MOST_NODES = 10


class NetDescriptions:
    """Descriptions of nets by the nodes; of one net of several nodes, the newest counts."""

    def __init__(self) -> None:
        self._by_net: dict[str, dict[str, Mapping[str, object]]] = {}

    def add(self, net: str, node: str, content: Mapping[str, object]) -> None:
        """Enter the description of a net by a node, in the place of the former one."""
        others = list(self._others(net, node).items())[-(MOST_NODES - 1) :]
        self._by_net[net] = {**dict(others), node: content}

    def withdraw(self, net: str, node: str) -> bool:
        """Remove the description of a net by a node; return whether the description was the newest."""
        if node not in (described := self._by_net.get(net, {})):
            return False
        others = self._others(net, node)
        if others:
            self._by_net[net] = others
        else:
            del self._by_net[net]
        return node == list(described)[-1]

    def newest(self, net: str) -> tuple[str, Mapping[str, object]]:
        """Return the running node of a net, and the description.

        Raises:
            NotFoundError: No node describes such a net.
        """
        described = self._by_net.get(net)
        if described is None:
            raise NotFoundError(kind="net", name=net, known=list(self._by_net))
        return list(described.items())[-1]

    def _others(self, net: str, node: str) -> dict[str, Mapping[str, object]]:
        return {other: content for other, content in self._by_net.get(net, {}).items() if other != node}
