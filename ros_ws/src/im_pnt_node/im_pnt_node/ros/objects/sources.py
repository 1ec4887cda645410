"""Inputs of guards beside the net: validity of data objects and last messages of topics."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile

from im_core.errors import DataError, ImError, nearest
from im_core.ros.calls import pause
from im_core.ros.dom import DomClient
from im_core.ros.node import ManagedNode
from im_pnt.errors import NetError
from im_pnt_node.rerun.log import MissionLog
from im_pnt_node.ros.messages import packed_message

AGAIN_S = 1.0
"""After so long what ``/dom`` has not answered is asked for again [s]."""


class Sources:
    """Follower of the declared inputs of guards (:func:`im_pnt.execution.functions.woken_by`).

    Args:
        node: The node.
        dom: Client of the Data Object Manager.
        log: Is told of messages, from which guards can be asked again.
        changed: Is told of each source that has changed, as guards declare it.
    """

    def __init__(self, node: ManagedNode, dom: DomClient, log: MissionLog, changed: Callable[[str], None]) -> None:
        self._node, self._dom, self._log, self._changed = node, dom, log, changed
        self._valid: dict[str, bool] = {}
        self._unknown: set[str] = set()
        self._last: dict[str, Any] = {}

    def follow(
        self, topic: str, message_type: type, profile: QoSProfile, check: Callable[[Any], object] = lambda _: None
    ) -> None:
        """Follow a topic, so messages of the topic may wake guards.

        Args:
            topic: Its name.
            message_type: Its type.
            profile: Quality of service.
            check: Raises what is wrong with a message that makes no sense, or returns False for one of no use; the last
                of use stays then.
        """
        self._last[topic] = None
        self._node.create_subscription(message_type, topic, partial(self._hear, topic, check), profile)

    def last(self, topic: str) -> Any:
        """Return the last message of a followed topic, None before the first."""
        return self._last[topic]

    def tell(self) -> None:
        """Note the last messages again, for a new listener."""
        for topic, message in self._last.items():
            if message is not None:
                self._log.add("heard", topic, *packed_message(message))

    def valid(self, name: str) -> bool:
        """Return whether a declared data object of a guard is valid."""
        return self._valid[name]

    def check_topics(self, net: str, sources: Iterable[str]) -> None:
        """Check whether the topics of the guards of a net are followed.

        Raises:
            NetError: One is not.
        """
        for topic in _named("topic", sources):
            if topic not in self._last:
                text = f"a guard of net {net} is woken by topic {topic}, which the node does not follow"
                raise NetError(f"{text}{nearest(topic, self._last)}", net=net, topic=topic)

    def declare(self, sources: Iterable[str]) -> None:
        """Enter the data objects of the guards of a net; none is valid until :meth:`look` has ended."""
        for name in _named("data", sources) - self._valid.keys():
            self._valid[name] = False
            self._unknown.add(name)

    async def meet(self, sources: Iterable[str]) -> None:
        """Enter the data objects of the guards of a coming net, and ask for the validity.

        Raises:
            ImError: ``/dom`` does not tell.
        """
        self.declare(sources)
        for name in self._unknown & _named("data", sources):
            self._learned(name, await self._dom.is_valid(name))

    def keep(self, sources: Iterable[str]) -> None:
        """Drop the data objects without a guard."""
        for name in self._valid.keys() - _named("data", sources):
            del self._valid[name]
            self._unknown.discard(name)

    async def look(self) -> None:
        """Ask for the validity of the objects declared by guards; end with the answer of ``/dom``."""
        for name in tuple(self._valid):
            self._learned(name, await valid_or_not(self._node, self._dom, name))

    def _learned(self, name: str, valid: bool) -> None:
        self._unknown.discard(name)
        if self._valid.get(name, valid) != valid:  # its net may have gone meanwhile
            self.object_changed(name, valid)

    def follows(self, name: str) -> bool:
        """Whether a guard has declared a data object."""
        return name in self._valid

    def object_changed(self, name: str, valid: bool) -> None:
        """Take in the changed validity of a data object."""
        if name in self._valid:
            self._valid[name] = valid
            self._changed(f"data:{name}")

    async def check(self, names: Iterable[str], done: Callable[[ImError | None], None]) -> None:
        """Check whether data objects are valid, and call back with the fault, if there is one."""
        try:
            for name in names:
                if not await self._dom.is_valid(name):
                    raise DataError(f"data object {name} is not valid although its place is to be marked", object=name)
        except ImError as error:
            done(error)
        else:
            done(None)

    def _hear(self, topic: str, check: Callable[[Any], object], message: Any) -> None:
        if check(message) is False:
            return
        self._last[topic] = message
        self._log.add("heard", topic, *packed_message(message))
        self._changed(f"topic:{topic}")


def _named(kind: str, sources: Iterable[str]) -> set[str]:
    """The names of the sources of a kind."""
    split = (source.partition(":") for source in sources)
    return {name for of, _, name in split if of == kind}


async def valid_or_not(node: ManagedNode, dom: DomClient, name: str) -> bool:
    """Whether an object is valid; asked until ``/dom`` can tell."""
    while True:
        try:
            return await dom.is_valid(name)
        except ImError as error:
            node.get_logger().warning(f"whether data object {name} is valid is not known yet: {error.message}")
            await pause(node, AGAIN_S)
