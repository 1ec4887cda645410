"""Connection to a machine: one ROS node, spun by a thread, with calls waiting for answers."""

import concurrent.futures
import itertools
import math
import os
import re
import threading
import time
from collections.abc import Callable
from typing import Any, Self, TypeVar

import rclpy
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future

from im.errors import MachineError, UnreachableError
from im.messages import message_of
from im.waits import wait_for
from im_core.processes.host_record import reach_machine
from im_core.ros.rclpy_fixes.bounded_end import bounded_end

ResultT = TypeVar("ResultT")

#: Longest wait for a server to be found, and for an answer [s]: the machine starts a dead task again in this time.
PATIENCE_S = 60.0
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EVENTS = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)

_POLL_S = 0.02
#: How often a wait for an answer looks whether the task still lives that was asked [s].
_LOOK_S = 0.5
#: Of DDS: a higher domain has no ports, and Fast DDS ends the process.
_MOST_DOMAIN = 232
_NUMBERS = itertools.count(1)


class Connection:
    """Node of a client in a separate context; usable from any thread.

    Args:
        domain: ROS domain; None: ``ROS_DOMAIN_ID``.

    Attributes:
        name: Name of the node; owner of what the client reserves.
        domain: ROS domain.
        node: The node.
        living: Returns, for the name of a service, an action or a topic, a check whether the task that has it now will
            still answer; the check raises :class:`im.UnreachableError`. Set by :class:`im.heartbeats.Heartbeats`.

    Raises:
        MachineError: There is no such domain.
    """

    def __init__(self, domain: int | None = None) -> None:
        named = os.environ.get("ROS_DOMAIN_ID") or 0 if domain is None else domain
        if not re.fullmatch("[0-9]{1,3}", str(named)) or int(named) > _MOST_DOMAIN:
            raise MachineError(f"{named!r:.60} is no ROS domain: a number from 0 to {_MOST_DOMAIN}", "argument")
        self.living: Callable[[str], Callable[[], None]] = lambda name: lambda: None
        self.name = f"im_client_{os.getpid()}_{next(_NUMBERS)}"
        self._context = Context()
        reach_machine(None if domain is None else int(named))
        rclpy.init(context=self._context, domain_id=domain)
        self.domain = int(self._context.get_domain_id())
        self.node = Node(self.name, context=self._context, start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Client] = {}
        self._actions: dict[str, ActionClient] = {}
        self._latest: dict[str, list[Any]] = {}
        self._closing = False
        self._thread = threading.Thread(target=self._spin, name=self.name, daemon=True)
        self._thread.start()

    def call(self, kind: Any, service: str, patience: float = PATIENCE_S, **fields: object) -> Any:
        """Return the answer of a service.

        Args:
            kind: Type of the service.
            service: Name of the service.
            patience: Longest wait for the server, and for the answer [s].
            **fields: Fields of the request.

        Raises:
            UnreachableError: No server, or no answer.
            MachineError: A value does not fit the type of its field.
        """
        request = message_of(kind.Request, **fields)
        if service not in self._clients:
            self._clients[service] = self.inside(lambda: self.node.create_client(kind, service))
        client = self._clients[service]
        self.until(client.service_is_ready, f"the service {service}", patience, service)
        lives = self.living(service)
        future = self.inside(lambda: client.call_async(request))
        try:
            return self.result(future, f"an answer of {service}", patience, lives)
        except UnreachableError:
            self.inside(lambda: client.remove_pending_request(future))
            raise

    def action(self, kind: Any, name: str) -> ActionClient:
        """Return the client of an action, once a server is there.

        Raises:
            UnreachableError: No server.
        """
        if name not in self._actions:
            self._actions[name] = self.inside(lambda: ActionClient(self.node, kind, name))
        self.until(self._actions[name].server_is_ready, f"the action {name}", PATIENCE_S, name)
        return self._actions[name]

    def subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None], profile: QoSProfile) -> Subscription:
        """Subscribe to a topic; the callback runs in the thread of the connection, and must return soon."""
        return self.inside(lambda: self.node.create_subscription(kind, topic, callback, profile))

    def unsubscribe(self, subscription: Subscription) -> None:
        """End a subscription."""
        self.inside(lambda: self.node.destroy_subscription(subscription))

    def latest(self, kind: Any, topic: str, timeout: float = PATIENCE_S) -> Any:
        """Return the last message of a latched topic.

        Raises:
            UnreachableError: No message.
        """
        if topic not in self._latest:
            last: list[Any] = []
            self._latest[topic] = last

            def keep(message: Any) -> None:
                last[:] = [message]

            self.subscribe(kind, topic, keep, LATCHED)
        last = self._latest[topic]
        self.until(lambda: bool(last), f"a message on {topic}", timeout, topic)
        self.living(topic)()  # the last message of a machine that has ended is none of the present
        return last[0]

    def inside(self, function: Callable[[], ResultT]) -> ResultT:
        """Call a function in the thread of the connection: each request is noted before the answer."""
        if threading.current_thread() is self._thread:
            return function()
        if self._closing:
            raise MachineError("the connection is closed")
        outcome: concurrent.futures.Future[ResultT] = concurrent.futures.Future()

        def carry() -> None:
            try:
                outcome.set_result(function())
            except Exception as error:  # raised at the caller
                outcome.set_exception(error)

        self._executor.create_task(carry)
        while not concurrent.futures.wait([outcome], timeout=1.0).done:
            if not self._thread.is_alive():
                raise MachineError("the connection is closed")
        return outcome.result()

    def result(self, future: Future, what: str, timeout: float | None, lives: Callable[[], None]) -> Any:
        """Wait for a future, and return the result.

        Args:
            future: The future.
            what: What is waited for.
            timeout: Longest wait [s]; None: as long as the other side lives.
            lives: Raises an error once the other side has died; see :attr:`living`.

        Raises:
            UnreachableError: The result did not come in time, or the other side has died.
        """
        done = threading.Event()
        self.inside(lambda: future.add_done_callback(lambda _: done.set()))
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        while not wait_for(done, min(_LOOK_S, max(0.0, deadline - time.monotonic()))):
            lives()
            if time.monotonic() > deadline:
                raise UnreachableError(f"waited {timeout:g} s in vain for {what}")
        return future.result()

    def until(self, ready: Callable[[], bool], what: str, timeout: float, name: str = "/") -> None:
        """Wait until a condition holds.

        Args:
            ready: The condition.
            what: What is waited for.
            timeout: Longest wait [s].
            name: Name of a service, an action or a topic, where its task may have ended for good.

        Raises:
            UnreachableError: The condition does not hold in time.
            MachineError: The connection is closed.
        """
        deadline = time.monotonic() + timeout
        while not self._closing:
            if ready():
                return
            self.living(name)()
            if time.monotonic() > deadline:
                raise UnreachableError(f"waited {timeout:g} s in vain for {what} in ROS domain {self.domain}")
            time.sleep(_POLL_S)
        raise MachineError("the connection is closed")

    def count(self) -> int:
        """Return a number unique among the requests of the process."""
        return next(_NUMBERS)

    def close(self) -> None:
        """End node and thread; waits of other threads fail."""
        self._closing = True
        self._executor.wake()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _spin(self) -> None:
        while not self._closing:
            self._executor.spin_once(timeout_sec=1.0)
        self._executor.shutdown()
        for action in self._actions.values():
            action.destroy()
        with bounded_end():
            self.node.destroy_node()
            self._context.try_shutdown()
            self._context.destroy()
