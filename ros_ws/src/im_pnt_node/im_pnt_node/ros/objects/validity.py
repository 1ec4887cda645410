"""Agreement between the token in a place and the validity of the data object."""

from collections.abc import Callable, Mapping

from im_core.errors import ImError
from im_core.ros.calls import pause
from im_core.ros.dom import DomClient
from im_core.ros.node import ManagedNode
from im_pnt.execution.events import ObjectInvalidated
from im_pnt.execution.executor import Executor

#: After so long what ``/dom`` has not answered is asked for again [s].
AGAIN_S = 1.0


class Validity:
    """Mover of tokens to ``on_invalid`` once the data object is not valid.

    What ``/dom`` tells of changes may come late (the object was put again since), or never (one of both was dead, or
    had not discovered the other). So it only says which object is to be looked at; the answer of ``/dom`` counts.
    Looked at is also each object that a token has come to stand for, and each that one stands for when this node begins
    or ``/dom`` has come back.

    Args:
        node: The node.
        dom: Client of the Data Object Manager.
        nets: The nets by name; looked at anew each time.
        settled: Is told of an object that was to be looked at, and whether it is valid.
    """

    def __init__(
        self, node: ManagedNode, dom: DomClient, nets: Mapping[str, Executor], settled: Callable[[str, bool], None]
    ) -> None:
        self._node, self._dom, self._nets, self._settled = node, dom, nets, settled
        self._shown: set[str] = set()
        self._wanted: dict[str, None] = {}
        self._looking = False

    def shows(self, name: str) -> bool:
        """Return whether a token stands for an object, by the name in the DOM, and would go with the validity."""
        return any(name in executor.rule.shown_objects() for executor in self._nets.values())

    def turned(self) -> None:
        """Check the objects of tokens placed by the last firings."""
        shown = self._all_shown()
        for name in shown - self._shown:
            self.look(name)
        self._shown = shown

    def look(self, name: str) -> None:
        """Has an object looked at, soon."""
        self._wanted[name] = None
        if not self._looking:
            self._looking = True
            self._node.spawn(self._look())

    def lost(self, name: str) -> None:
        """Move the tokens of an invalid object."""
        for executor in self._nets.values():
            executor.post(ObjectInvalidated(name))

    async def compare(self) -> None:
        """Check the objects of all tokens; end with the answer of ``/dom``."""
        for name in sorted(self._all_shown()):
            if not await valid_or_not(self._node, self._dom, name):
                self._settled(name, False)

    async def _look(self) -> None:
        while self._wanted:
            name = next(iter(self._wanted))
            del self._wanted[name]
            self._settled(name, await valid_or_not(self._node, self._dom, name))
        self._looking = False

    def _all_shown(self) -> set[str]:
        return {name for executor in self._nets.values() for name in executor.rule.shown_objects()}


async def valid_or_not(node: ManagedNode, dom: DomClient, name: str) -> bool:
    """Whether an object is valid; asked until ``/dom`` can tell."""
    while True:
        try:
            return await dom.is_valid(name)
        except ImError as error:
            node.get_logger().warning(f"whether data object {name} is valid is not known yet: {error.message}")
            await pause(node, AGAIN_S)
