"""Awaited messages of transitions: any topic of any node.

A topic is listened to from the moment in which its net is loaded, for discovery takes time; what counts is what arrives
when the action has begun. Messages are decoded only while somebody waits.
"""

from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from im_core.clock import monotonic
from im_core.errors import ImError
from im_core.ros.calls import pause
from im_core.ros.coroutines import Promise
from im_core.ros.messages.interfaces import decoded, interface_class
from im_core.ros.node import ManagedNode
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Activity
from im_pnt.model.action import AwaitAction
from im_pnt_node.ros.execution.actions import RosActions, answer_key, handled
from im_pnt_node.ros.execution.endpoints import RosAction
from im_pnt_node.ros.messages import packed_message, plain_fields

DEPTH = 100


class AwaitActions(RosActions[dict[bool, "_Listener"]]):
    """Waits for messages: of a topic for new ones, and for latched ones where an action wants these too."""

    def prepare(self, action: RosAction) -> dict[bool, "_Listener"]:
        """Return the listeners to a topic by whether latched messages count; begin to listen before the first use.

        Raises:
            NotFoundError: No such type is installed.
            EndpointGoesError: The topic is of another type, and is listened to no more.
        """
        assert isinstance(action, AwaitAction)
        listeners = super().prepare(action)
        if action.latched not in listeners:
            kind = interface_class(action.type)
            listeners[action.latched] = _Listener(self._surroundings.node, action.name, kind, action.latched)
        return listeners

    def perform(self, activity: Activity, context: ActionContext) -> Coroutine[object, object, dict[str, object]]:
        """Take the next message from now on; every message counts, also one before the start of the coroutine.

        Raises:
            ImError: It was cancelled, or the handler failed.
        """
        action = activity.action
        assert isinstance(action, AwaitAction)
        listener = self.prepare(action)[action.latched]
        promise = listener.next(partial(self._counts, action, context))

        def give_up() -> None:
            listener.drop(promise)
            late = activity.deadline is not None and monotonic() >= activity.deadline
            if not promise.done() and not late:  # what is late ends by the answer to what became of it
                promise.set_exception(ImError(f"the wait for a {action} was cancelled", code="cancelled"))

        activity.when_cancelled(give_up)
        if action.silent is not None:
            self._surroundings.node.spawn(self._listen_for_silence(listener, promise, action, action.silent))
        return self._take(promise, activity, action, context)

    async def _listen_for_silence(
        self, listener: "_Listener", promise: Promise, action: AwaitAction, longest: float
    ) -> None:
        """Have a wait fail once its topic has been silent for too long, counted from its begin at the earliest."""
        began = monotonic()
        while not promise.done():
            left = max(began, listener.heard) + longest - monotonic()
            if left > 0.0:
                await pause(self._surroundings.node, left)
            elif not promise.done():
                listener.drop(promise)
                promise.set_exception(action.silence)

    def ask(self, activity: Activity, _: ActionContext) -> Answer:
        """Return the outcome of a wait after the time: failed, even before the cancellation is known."""
        return Answer(Outcome.FAILED, activity.doubt, asked="nobody: it only waited")

    def _counts(self, action: AwaitAction, context: ActionContext, message: Any) -> bool:
        if action.until is None:
            return True
        return context.holds(action.until, plain_fields(message, context.answer_ways, str(action)))

    def _make(self, name: str, type_name: str) -> dict[bool, "_Listener"]:
        interface_class(type_name)  # there is no topic of a type that is not installed
        return {}

    def _destroy(self, endpoint: dict[bool, "_Listener"]) -> None:
        for listener in endpoint.values():
            listener.close()

    async def _take(
        self, promise: Promise, activity: Activity, action: AwaitAction, context: ActionContext
    ) -> dict[str, object]:
        message = await self._surroundings.log.read(answer_key(activity), promise, packed_message)
        return await handled(self._surroundings.functions, action, context, message)


class _Listener:
    """Subscription with the quality of service of the publishers: no more is requested than offered.

    Args:
        node: The node.
        topic: Name of the topic.
        message_type: Its type.
        latched: Whether the last message counts for whoever comes later.

    Attributes:
        heard: When the last message came (monotonic) [s].
    """

    def __init__(self, node: ManagedNode, topic: str, message_type: Any, latched: bool) -> None:
        self._node, self._topic, self._type, self._latched = node, topic, message_type, latched
        self._waiting: dict[Promise, Callable[[Any], bool]] = {}
        self._last: Any = None
        self.heard = 0.0
        self._reliable, self._durable = True, latched
        self._subscription = self._subscribe()

    def next(self, counts: Callable[[Any], bool]) -> Promise:
        """Return the promise of the next counting message, or of a latched message, if the latched one counts."""
        promise = self._node.promise()
        self._waiting[promise] = counts
        if self._last is not None:
            self._offer(promise, self._last)
        return promise

    def drop(self, promise: Promise) -> None:
        """Forget a promise without a waiting action."""
        self._waiting.pop(promise, None)

    def close(self) -> None:
        """Stop listening."""
        self._node.destroy_subscription(self._subscription)

    def _hear(self, data: bytes) -> None:
        self.heard = monotonic()
        if self._latched or self._waiting:
            message = decoded(data, self._type)
            self._last = message if self._latched else None
            for promise in tuple(self._waiting):
                self._offer(promise, message)

    def _offer(self, promise: Promise, message: Any) -> None:
        """Keep a promise if a message counts, or where the value is undecided."""
        try:
            if self._waiting[promise](message):
                self.drop(promise)
                promise.set_result(message)
        except ImError as error:
            self.drop(promise)
            promise.set_exception(error)

    def _subscribe(self) -> Subscription:
        reliability = ReliabilityPolicy.RELIABLE if self._reliable else ReliabilityPolicy.BEST_EFFORT
        durability = DurabilityPolicy.TRANSIENT_LOCAL if self._durable else DurabilityPolicy.VOLATILE
        profile = QoSProfile(
            history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=reliability, durability=durability
        )
        refused: Callable[[Any], None] = self._node.guarded(f"subscription {self._topic} (its quality)", self._adapt)
        return self._node.create_subscription(
            self._type,
            self._topic,
            self._hear,
            profile,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=refused),
        )

    def _adapt(self, _: object) -> None:
        """Request less: a publisher cannot give the requested quality of service."""
        ends = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self._topic))
        reliable = all(end.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT for end in ends)
        durable = self._latched and all(end.qos_profile.durability != DurabilityPolicy.VOLATILE for end in ends)
        if (reliable, durable) == (self._reliable, self._durable):
            return
        if self._latched and not durable:
            self._node.get_logger().warning(f"a publisher of {self._topic} does not latch it: only what comes counts")
        self._reliable, self._durable = reliable, durable
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._subscribe()
