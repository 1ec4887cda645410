"""Agreement between nets and data objects: tokens in places, and guards."""

from collections.abc import Callable, Mapping

from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros.dom import DomClient
from im_core.ros.node import ManagedNode
from im_msgs.msg import ObjectChange
from im_pnt.execution.events import ObjectInvalidated
from im_pnt.execution.executor import Executor
from im_pnt_node.rerun.log import MissionLog
from im_pnt_node.ros.objects.objects import DomObjects
from im_pnt_node.ros.objects.sources import Sources, valid_or_not


class Validity:
    """Follower of the changes of data objects: moves tokens to ``on_invalid``, and has guards asked again.

    What ``/dom`` tells of changes may come late (the object was put again since), or never (one of both was dead, or
    had not discovered the other). So it only says which object is to be looked at; the answer of ``/dom`` counts.
    Looked at is also each object that a token has come to stand for, and each that one stands for when this node begins
    or ``/dom`` has come back.

    Args:
        node: The node.
        dom: Client of the Data Object Manager.
        nets: The nets by name; looked at anew each time.
        log: Is told of each object that has changed.
        sources: What guards look at.
        objects: What expressions look at.
        changed: Has all guards asked again.
    """

    def __init__(
        self,
        node: ManagedNode,
        dom: DomClient,
        nets: Mapping[str, Executor],
        log: MissionLog,
        sources: Sources,
        objects: DomObjects,
        changed: Callable[[], None],
    ) -> None:
        self._node, self._dom, self._nets, self._log = node, dom, nets, log
        self._sources, self._objects, self._changed = sources, objects, changed
        self._shown: set[str] = set()
        self._wanted: dict[str, None] = {}
        self._looking = False
        node.create_subscription(ObjectChange, "/dom/changes", self._hear, qos.LATCHED_EVENTS)

    def turned(self) -> None:
        """Check the objects of tokens placed by the last firings."""
        shown = self._all_shown()
        for name in shown - self._shown:
            self._look_at(name)
        self._shown = shown

    async def compare(self) -> None:
        """Check the objects of all tokens and guards: changes told while the node or ``/dom`` was dead are lost."""
        self._dom.forget_known()
        self._node.spawn(self._compare_store())
        self._objects.stale()
        await self._sources.look()
        for name in sorted(self._all_shown()):
            if not await valid_or_not(self._node, self._dom, name):
                self._settle(name, False)
        self._changed()

    async def _compare_store(self) -> None:
        """Log a loss of known objects by the store of /dom; nothing waits for the answer."""
        try:
            await self._dom.compare_store()
        except ImError as error:  # the next answer of the store tells
            text = f"whether the object store has lost anything is not known yet: {error.message}"
            self._node.get_logger().warning(text)

    def _hear(self, change: ObjectChange) -> None:
        self._dom.heard(change.object)
        name = change.object.name
        if name in self._all_shown() or self._sources.follows(name):
            self._look_at(name)
        else:
            self._settle(name, bool(change.object.valid))

    def _look_at(self, name: str) -> None:
        """Look at an object soon."""
        self._wanted[name] = None
        if not self._looking:
            self._looking = True
            self._node.spawn(self._look())

    def _settle(self, name: str, valid: bool) -> None:
        """Take in the state of a changed data object."""
        self._log.add("object", name, valid)
        self._sources.object_changed(name, valid)
        if self._objects.forget(name):
            self._changed()
        if not valid:
            for executor in self._nets.values():
                executor.post(ObjectInvalidated(name))

    async def _look(self) -> None:
        while self._wanted:
            name = next(iter(self._wanted))
            del self._wanted[name]
            self._settle(name, await valid_or_not(self._node, self._dom, name))
        self._looking = False

    def _all_shown(self) -> set[str]:
        return {name for executor in self._nets.values() for name in executor.rule.shown_objects()}
