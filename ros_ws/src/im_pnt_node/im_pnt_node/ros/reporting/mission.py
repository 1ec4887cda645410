"""Publish the events for a re-run (:mod:`im_pnt_node.rerun.log`) on ``/pnt/events``, while somebody subscribes."""

import json
import uuid
from collections.abc import Callable, Iterable
from typing import TypeVar

from rclpy.event_handler import PublisherEventCallbacks
from std_msgs.msg import String

from im_core.clock import monotonic
from im_core.ros import qos
from im_core.ros.dom import DomClient
from im_core.ros.node import ManagedNode
from im_pnt.execution.executor import Executor
from im_pnt.netfile import yaml_text
from im_pnt_node.distributed.codec import encode_json
from im_pnt_node.journal.state import net_state
from im_pnt_node.rerun.log import MissionLog
from im_pnt_node.ros.messages import packed_message

TOPIC = "/pnt/events"
MessageT = TypeVar("MessageT")


class MissionPublisher:
    """Publisher of numbered events, a message a turn; a late subscriber gets the states first.

    A node whose nets keep no journal tells nothing.

    Args:
        node: The node.
        log: What there is to tell.
        functions: What makes the functions of its nets, as ``module:function``; empty: nobody can make them again.
        nets: The nets in execution.
        sources: Notes what guards look at.
    """

    def __init__(
        self,
        node: ManagedNode,
        log: MissionLog,
        functions: str,
        nets: Callable[[], Iterable[Executor]],
        sources: Callable[[], None],
    ) -> None:
        self._node, self._log, self._functions, self._nets, self._sources = node, log, functions, nets, sources
        self._incarnation, self._number = uuid.uuid4().hex, 0
        self._anew, self._begun = False, False
        matched = PublisherEventCallbacks(matched=node.guarded(f"publisher {TOPIC} (who listens)", self._matched))
        self._publisher = node.create_publisher(String, TOPIC, qos.EVENTS, event_callbacks=matched)

    def begin(self) -> None:
        """Note the moment from which the nets may fire."""
        self._begun = self._anew = True
        self.publish()

    def loaded(self, executor: Executor) -> None:
        """Report a new net."""
        if self._begun and self._publisher.get_subscription_count():
            self._tell_state(executor)

    def publish(self) -> None:
        """Publish the collected events; events before the first firing are part of the states."""
        listened_to = self._begun and self._publisher.get_subscription_count() > 0
        self._log.recorded = listened_to and all(each.record is not None for each in self._nets())
        if not self._log.recorded:
            self._log.items.clear()
            self._anew = True
            return
        if self._anew:
            self._anew = False
            self._log.add("node", self._node.get_fully_qualified_name(), self._functions)
            for executor in self._nets():
                self._tell_state(executor)
            self._sources()
        if self._log.items:
            self._number += 1
            stamp = self._node.get_clock().now().nanoseconds * 1e-9
            head = {"life": self._incarnation, "number": self._number, "at": monotonic(), "stamp": stamp}
            head_text = json.dumps({"node": self._node.get_fully_qualified_name(), **head})
            self._publisher.publish(String(data=f'{head_text[:-1]}, "items": [{",".join(self._log.items)}]}}'))
            self._log.items.clear()

    def _tell_state(self, executor: Executor) -> None:
        self._log.items.append(
            encode_json(["state", executor.net.name, net_state(executor), yaml_text(executor.written)])
        )

    def _matched(self, _: object) -> None:
        self._anew = True
        self.publish()


class NotedObjects:
    """Data objects read and stored by functions and expressions of nets."""

    def __init__(self, dom: DomClient, log: MissionLog) -> None:
        self._dom, self._log = dom, log

    async def get(self, name: str, message_type: type[MessageT]) -> MessageT:
        """Return an object; raise as the client does."""
        return await self._log.read(["get", name], self._dom.get(name, message_type), packed_message)

    async def put(self, name: str, message: object, place: str = "") -> int:
        """Store an object; raise as the client does."""
        self._log.sent(["put", name], packed_message(message))
        return await self._log.read(["put", name], self._dom.put(name, message, place), int)

    async def append(self, name: str, message: object) -> int:
        """Append to an object; raise as the client does."""
        self._log.sent(["append", name], packed_message(message))
        return await self._log.read(["append", name], self._dom.append(name, message), int)

    async def is_valid(self, name: str) -> bool:
        """Return whether there is a valid object of a name."""
        return await self._log.read(["valid", name], self._dom.is_valid(name), bool)

    async def invalidate(self, name: str) -> None:
        """Declare an object invalid; raise as the client does."""
        self._log.sent(["invalidate", name], None)
        await self._log.read(["invalidate", name], self._dom.invalidate(name), lambda _: None)
