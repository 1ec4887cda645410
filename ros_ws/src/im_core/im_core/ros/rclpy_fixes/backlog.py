"""Read messages already in a reader when an executor begins to listen.

- Upstream: where the events executor asks for notifications of messages, requests and answers, ``rmw_fastrtps`` counts
  first what is there, and registers the listener afterwards. An arrival between the two is notified with the next
  message of the same reader only, which for a latched topic, a request or an answer may never come.
- Mend: look into each reader once after the executor has begun to listen.
- Issue: none is known.
- Seen: rmw_fastrtps 8.4 with rclpy 7.1.6 (Jazzy).
- Test: ``test_rmw_still_misses_what_comes_while_a_reader_is_new`` in
  ``test/test_backlog.py`` fails once upstream has mended it.
"""

from collections.abc import Iterator, MutableSet
from typing import Any

from rclpy.action import ActionClient, ActionServer
from rclpy.client import Client
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription


def new_readers(node: Node, known: MutableSet[Any]) -> Iterator[Any]:
    """Yield the new readers of a node: subscriptions, services, clients and actions not known before.

    A node keeps them in the order in which they were made: those that are new are the last ones.

    Args:
        node: The node.
        known: Those that were known; the new ones are added.
    """
    for kind in (node.subscriptions, node.services, node.clients, node.waitables):
        for reader in reversed(tuple(kind)):
            if reader in known:
                break
            known.add(reader)
            if isinstance(reader, Subscription | Service | Client | ActionClient | ActionServer):
                yield reader


def take_backlog(reader: Any, executor: Any) -> None:
    """Take everything waiting in a reader, as the executor would; in the loop.

    Args:
        reader: One of :func:`new_readers`; of one that was destroyed nothing is taken.
        executor: The events executor that listens to it.

    Raises:
        Exception: What a callback raised; what waits behind that is taken with the next message.
    """
    try:
        if isinstance(reader, Subscription):
            _hear(reader)
        elif isinstance(reader, Service):
            serve_waiting(reader)
        elif isinstance(reader, Client):
            _complete(reader, executor)
        else:
            _act(reader, executor)
    except InvalidHandle:
        return


def _hear(subscription: Any) -> None:
    handle = subscription.handle
    with handle:
        while (taken := handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            alone = subscription._callback_type is Subscription.CallbackType.MessageOnly
            subscription.callback(taken[0] if alone else taken)


def serve_waiting(service: Any) -> None:
    """Answer all requests waiting in a service.

    Raises:
        InvalidHandle: The service was destroyed.
        Exception: What a callback raised.
    """
    handle = service.handle
    with handle:
        while (taken := handle.service_take_request(service.srv_type.Request))[1] is not None:
            request, header = taken
            service.send_response(service.callback(request, service.srv_type.Response()), header)


def _complete(client: Any, executor: Any) -> None:
    handle = client.handle
    with handle:
        while (taken := handle.take_response(client.srv_type.Response))[0] is not None:
            header, response = taken
            try:
                future = client.get_pending_request(header.request_id.sequence_number)
            except KeyError:  # nobody waits for it any more
                continue
            future._set_executor(executor)
            future.set_result(response)


def _act(action: Any, executor: Any) -> None:
    """Take all waiting data of an action; an action without a prior wait reports everything as ready."""
    n = action.get_num_entities()
    counts = (n.num_subscriptions, n.num_guard_conditions, n.num_timers, n.num_clients, n.num_services, n.num_events)
    context = executor.context.handle
    wait_set = _rclpy.WaitSet(*counts, context)
    with context, wait_set, action:
        action.add_to_wait_set(wait_set)
        action.is_ready(wait_set)
        if isinstance(action, ActionServer):
            action._is_goal_expired = False  # whether it is time to forget goals is a timer's business
        while any((taken := action.take_data()).values()):
            executor.create_task(action.execute, taken)
