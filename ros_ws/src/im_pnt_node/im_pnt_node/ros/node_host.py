"""The node as functions of its nets see it; what they learn from outside is noted, so that they can be run again."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from rclpy.client import Client

from im_core.ros.calls import ask_again, pause, run_in_thread
from im_core.ros.servers import reason
from im_pnt.execution.executor import Executor
from im_pnt.model.net import Net
from im_pnt_node.rerun.host import HostObjects
from im_pnt_node.ros.messages import packed_message
from im_pnt_node.ros.node import PntNode

ValueT = TypeVar("ValueT")

#: What has no effect is asked again where an answer was lost, as of a node that has just begun [s].
ANSWER_S, AGAIN_S = 40.0, 10.0


class NodeHost:
    """A :class:`im_pnt_node.rerun.host.Host`; functions take it before the node is made, and use it after."""

    def attach(self, node: PntNode) -> None:
        """Tells which node it stands for."""
        self._node, self._log = node, node.log
        self.name = node.get_fully_qualified_name()
        self.dom: HostObjects = node.objects
        self._clients: dict[str, Client] = {}

    @property
    def recorded(self) -> bool:
        """Whether somebody records what the node tells."""
        return self._log.recorded

    def prepare(self, service_type: type, service: str) -> None:
        """Makes the client of a service before it is needed: discovery takes time."""
        self._clients[service] = self._node.create_client(service_type, service)

    def last(self, topic: str) -> Any:
        """Returns the last message of a topic that the node follows."""
        return self._node.sources.last(topic)

    def parameter(self, name: str) -> Any:
        """Returns a parameter of the node."""
        return self._log.noted(["parameter", name], lambda: self._node.get_parameter(name).value)

    def life(self, task: str) -> int | None:
        """Returns the present life of a task."""
        return self._log.noted(["life", task], lambda: self._node.heartbeats.incarnation(task))

    async def ask(self, service_type: type, service: str, request: object, task: str, what: str) -> Any:
        """Returns the answer of a service, asked again where one was lost."""
        if service not in self._clients:
            self.prepare(service_type, service)

        async def ask() -> Any:
            future = self._clients[service].call_async(request)
            answer = await self._node.heartbeats.wait(future, task, AGAIN_S, what)
            if getattr(answer, "success", True) is False:
                told = answer.status if hasattr(answer, "status") else answer
                told.message = reason(self._node, told.message, service)
            return answer

        self._log.sent(["ask", service], packed_message(request))
        return await self._log.read(["ask", service], ask_again(ask, ANSWER_S, what), packed_message)

    async def pause(self, seconds: float) -> None:
        """Lets wall time pass [s]."""
        await self._log.read(["pause"], pause(self._node, seconds), lambda _: None)

    def noted(self, key: str, compute: Callable[[], ValueT]) -> ValueT:
        """Returns what is computed from the world outside, JSON data."""
        return self._log.noted([key], compute)

    async def noted_apart(self, key: str, compute: Callable[..., ValueT], *arguments: object) -> ValueT:
        """Does the same in a thread of its own."""
        return await self._log.read([key], run_in_thread(self._node, compute, *arguments), lambda value: value)

    def warn(self, text: str) -> None:
        """Writes a line to the log."""
        self._node.get_logger().warning(text)

    def executor(self, net: str) -> Executor:
        """Returns a net of the node in execution."""
        return self._node.exchange.nets[net]

    def nets(self) -> Sequence[Net]:
        """Returns the nets of the node, as written."""
        return [executor.written for executor in self._node.exchange.nets.values()]
