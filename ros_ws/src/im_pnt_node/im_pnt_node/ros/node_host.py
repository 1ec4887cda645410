"""The node as seen by functions of the nets; outside facts are noted for a re-run."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from rclpy.client import Client

from im_core.ros.calls import ask_again, pause, run_in_thread
from im_core.ros.peers.servers import reason
from im_pnt.execution.executor import Executor
from im_pnt.execution.values import Objects
from im_pnt.model.net import Net
from im_pnt_node.rerun.host import HostObjects
from im_pnt_node.ros.messages import packed_message
from im_pnt_node.ros.node import PntNode

ValueT = TypeVar("ValueT")

#: What has no effect is asked again where an answer was lost, as of a node that has just begun [s].
ANSWER_S, AGAIN_S = 40.0, 10.0


class NodeHost:
    """Host (:class:`im_pnt_node.rerun.host.Host`) given to functions before the node exists, and used afterwards."""

    def attach(self, node: PntNode) -> None:
        """Set the node behind the host."""
        self._node, self._log = node, node.log
        self.name = node.get_fully_qualified_name()
        self.dom: HostObjects = node.objects
        self.values: Objects = node.values
        self._clients: dict[str, Client] = {}

    @property
    def recorded(self) -> bool:
        """Whether a recorder listens to the node."""
        return self._log.recorded

    def prepare(self, service_type: type, service: str) -> None:
        """Create the client of a service before the first use: discovery takes time."""
        self._clients[service] = self._node.create_client(service_type, service)

    def last(self, topic: str) -> Any:
        """Return the last message of a topic followed by the node."""
        return self._node.sources.last(topic)

    def parameter(self, name: str) -> Any:
        """Return a parameter of the node."""
        return self._log.noted(["parameter", name], lambda: self._node.get_parameter(name).value)

    def incarnation(self, task: str) -> int | None:
        """Return the present incarnation of a task."""
        return self._log.noted(["life", task], lambda: self._node.heartbeats.incarnation(task))

    async def ask(self, service_type: type, service: str, request: object, task: str, what: str) -> Any:
        """Return the answer of a service; ask again where an answer was lost."""
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
        """Let wall time pass [s]."""
        await self._log.read(["pause"], pause(self._node, seconds), lambda _: None)

    def noted(self, key: str, compute: Callable[[], ValueT]) -> ValueT:
        """Return a value computed from the world outside, JSON data."""
        return self._log.noted([key], compute)

    async def noted_apart(self, key: str, compute: Callable[..., ValueT], *arguments: object) -> ValueT:
        """Return a value computed from the world outside, in a separate thread."""
        return await self._log.read([key], run_in_thread(self._node, compute, *arguments), lambda value: value)

    def warn(self, text: str) -> None:
        """Write a line to the log."""
        self._node.get_logger().warning(text)

    def executor(self, net: str) -> Executor:
        """Return a net of the node in execution."""
        return self._node.exchange.nets[net]

    def nets(self) -> Sequence[Net]:
        """Return the nets of the node, as written."""
        return [executor.written for executor in self._node.exchange.nets.values()]
