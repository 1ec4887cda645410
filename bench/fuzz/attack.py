"""Throws values at interfaces, and sees that everything is answered."""

import threading
from collections import Counter
from collections.abc import Iterable
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import QoSProfile

from bench.fuzz.targets import Target, is_order
from bench.fuzz.values import Values
from im_core import clock

#: How long an answer may take [s]; how many may be awaited at once.
ANSWER_S = 60.0
AT_ONCE = 20


class Attack:
    """Throws values at interfaces of a machine, from a node that spins elsewhere.

    Attributes:
        sent: How many messages, requests and goals were sent, by kind.
        unanswered: Names of services and actions that did not answer.
        refused: Messages that this end could not send.
    """

    def __init__(self, node: Node, values: Values) -> None:
        self._node, self._values = node, values
        self.sent: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.unanswered: list[str] = []
        self._free = threading.Semaphore(AT_ONCE)
        self._open: dict[Any, tuple[str, float]] = {}
        self._ends: dict[Target, Any] = {}

    def open(self, targets: Iterable[Target]) -> None:
        """Make publishers and clients, and wait a little for those at the other end."""
        for target in targets:
            self._ends[target] = self._end(target)
        deadline = clock.monotonic() + ANSWER_S
        for target, end in self._ends.items():
            while clock.monotonic() < deadline and not _met(target, end):
                clock.sleep(0.02)
        clock.sleep(0.5)  # the other side must have met this one, too, or its answer is lost

    def throw(self, target: Target) -> None:
        """Throw one thing at an interface."""
        end = self._ends[target]
        message = self._values.message(target.taken)
        if is_order(target, message):
            return
        if target.kind == "topic":
            self._publish(end, message)
            return
        self._free.acquire(timeout=ANSWER_S)
        begun = threading.Event()
        assert self._node.executor is not None, "the node spins"
        # in the loop: rclpy drops the answer to a goal that comes before the thread that sent it has noted it
        self._node.executor.create_task(self._ask, target, end, message, begun)
        begun.wait(ANSWER_S)

    def finish(self) -> None:
        """Wait for all answers."""
        while self._open and any(clock.monotonic() - since < ANSWER_S for _, since in list(self._open.values())):
            clock.sleep(0.02)
        self.unanswered = sorted(name for name, _ in self._open.values())

    def _publish(self, end: Any, message: Any) -> None:
        broken = self.sent["topic"] % 3 == 2
        try:
            end.publish(self._values.broken(message) if broken else message)
        except (UnicodeError, ValueError, AssertionError, RuntimeError):
            self.refused["topic"] += 1
        else:
            self.sent["topic"] += 1

    def _ask(self, target: Target, end: Any, request: Any, begun: threading.Event) -> None:
        try:
            future = end.call_async(request) if target.kind == "service" else end.send_goal_async(request)
        except (UnicodeError, ValueError, AssertionError):
            self.refused[target.kind] += 1
            self._free.release()
        else:
            self.sent[target.kind] += 1
            self._open[future] = target.name, clock.monotonic()
            future.add_done_callback(self._answered)
        begun.set()

    def _answered(self, future: Any) -> None:
        self._open.pop(future, None)
        self._free.release()

    def _end(self, target: Target) -> Any:
        if target.kind == "topic":
            return self._node.create_publisher(target.type, target.name, self._profile(target.name))
        if target.kind == "service":
            return self._node.create_client(target.type, target.name)
        return ActionClient(self._node, target.type, target.name)

    def _profile(self, topic: str) -> QoSProfile:
        """One that those who listen match."""
        asked = self._node.get_subscriptions_info_by_topic(topic)[0].qos_profile
        return QoSProfile(depth=10, durability=asked.durability, reliability=asked.reliability)


def _met(target: Target, end: Any) -> bool:
    if target.kind == "topic":
        return bool(end.get_subscription_count())
    return bool(end.service_is_ready() if target.kind == "service" else end.server_is_ready())
