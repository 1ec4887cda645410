"""Waits for services, threads and futures with a time-out naming the awaited event."""

import faulthandler
import threading
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

from rclpy.client import Client
from rclpy.task import Future

from im_core import clock
from im_core.errors import FOREIGN, LinkError, StateError, WaitTimeoutError, as_exception
from im_core.ros.node import ManagedNode

ResultT = TypeVar("ResultT")

#: How long work in a thread may take unless its caller says less [s], and how many threads a node may leave behind.
LONGEST_S = 3600.0
#: After how long the log says where the threads are [s].
LONG_S = 30.0
MOST_LEFT_BEHIND = 20

_left_behind: WeakKeyDictionary[ManagedNode, set[threading.Thread]] = WeakKeyDictionary()


async def wait(node: ManagedNode, future: Any, timeout_s: float, what: str) -> Any:
    """Await a future of rclpy, at most ``timeout_s`` of wall time [s].

    Raises:
        WaitTimeoutError: It did not complete in time.
    """
    promise = node.promise()

    def settle(_: object = None) -> None:  # by two threads at once does no harm: who awaits it goes on once
        if not promise.done():
            promise.set_result(None)

    alarm = node.alarms.after(timeout_s, settle)
    future.add_done_callback(settle)
    try:
        await promise
    finally:
        node.alarms.cancel(alarm)
    if not future.done():
        future.cancel()
        raise WaitTimeoutError(what=what, seconds=timeout_s)
    return future.result()


async def pause(node: ManagedNode, seconds: float) -> None:
    """Let ``seconds`` of wall time pass without blocking the executor."""
    promise = node.promise()

    def over() -> None:
        if not promise.done():
            promise.set_result(None)

    alarm = node.alarms.after(seconds, over)
    try:
        await promise
    finally:
        node.alarms.cancel(alarm)


async def call(node: ManagedNode, client: Client, request: Any, timeout_s: float, what: str) -> Any:
    """Call a service.

    Args:
        node: The calling node.
        client: Its client.
        request: The request.
        timeout_s: Longest wait, discovery included, wall time [s].
        what: What is waited for, for the message of the error.

    Raises:
        WaitTimeoutError: No such service, or no answer, in time.
    """
    deadline = clock.monotonic() + timeout_s
    while not client.service_is_ready():
        if clock.monotonic() > deadline:
            raise WaitTimeoutError(what=f"the service {client.srv_name} ({what})", seconds=timeout_s)
        await pause(node, 0.05)
    left = max(0.05, deadline - clock.monotonic())
    try:
        answer: Any = client.call_async(request)
        answer._set_executor = _none  # else the executor makes two tasks of each answer, a fifth of what a call costs
        return await wait(node, answer, left, f"an answer of {client.srv_name} ({what})")
    except RuntimeError as error:
        raise LinkError(f"the call of {client.srv_name} ({what}) failed: {error}") from error


async def ask_again(ask: Callable[[], Awaitable[ResultT]], patience_s: float, what: str) -> ResultT:
    """Repeat a request after each wait without an answer; for requests with the same effect when repeated.

    A server that has not discovered its client yet, or that dies, loses answers.

    Args:
        ask: Asks once, and waits for as long as an answer may take.
        patience_s: Longest time after which it is asked once more [s].
        what: What is waited for, for the message of the error.

    Raises:
        WaitTimeoutError: No answer has come.
    """
    deadline = clock.monotonic() + patience_s
    while True:
        try:
            return await ask()
        except WaitTimeoutError as error:
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=what, seconds=patience_s) from error


def call_blocking(client: Client, request: Any, timeout_s: float, what: str) -> Any:
    """Call a service from a thread without spinning (scripts and tests).

    Raises:
        WaitTimeoutError: No such service, or no answer, in time.
    """
    deadline = clock.monotonic() + timeout_s
    if not client.wait_for_service(timeout_sec=timeout_s):
        raise WaitTimeoutError(what=f"the service {client.srv_name} ({what})", seconds=timeout_s)
    done = threading.Event()
    future = client.call_async(request)
    future.add_done_callback(lambda _: done.set())
    if not done.wait(max(0.05, deadline - clock.monotonic())):
        client.remove_pending_request(future)
        raise WaitTimeoutError(what=f"an answer of {client.srv_name} ({what})", seconds=timeout_s)
    return future.result()


def _none(executor: object) -> None:
    """Stand in for a future's executor: the waiter is told in the loop, at the place taking the answer."""


def carry(function: Callable[[], object], ended: Future) -> None:
    """Call a function, and pass the return value or exception to a future."""
    try:
        result = function()
    except FOREIGN as error:  # it is raised where it is awaited
        ended.set_exception(as_exception(error))
    else:
        ended.set_result(result)


async def run_in_thread(
    node: ManagedNode,
    function: Callable[..., ResultT],
    *args: object,
    timeout_s: float = LONGEST_S,
    tell_after_s: float = LONG_S,
) -> ResultT:
    """Run a long or blocking function (files, databases, processes) in a separate thread; the loop goes on.

    A thread cannot be ended: one whose time is over is left behind, and what it brings is dropped. Of one that takes
    long the log says where it is: whether it computes, or waits for what does not come.

    Args:
        node: The node in whose loop this waits.
        function: What is to be run.
        *args: Its arguments.
        timeout_s: Longest wait, wall time [s].
        tell_after_s: When the log says where all threads are, for it takes long [s].

    Raises:
        WaitTimeoutError: It has not ended in time.
        StateError: So many threads of the node have not ended that no more is begun.
        Exception: What the function raised.
    """
    name = getattr(function, "__name__", "worker")
    if len(left := _left_behind.setdefault(node, set())) >= MOST_LEFT_BEHIND:
        known = ", ".join(sorted({thread.name for thread in left}))
        raise StateError(f"{name} is not started: {len(left)} earlier calls still run after their timeout ({known})")
    ended = Future()

    def run() -> None:
        carry(lambda: function(*args), ended)
        left.discard(threading.current_thread())

    def tell() -> None:
        node.get_logger().warning(f"{name} has not ended after {tell_after_s:g} s; this is where all threads are")
        faulthandler.dump_traceback()

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    alarm = node.alarms.after(tell_after_s, tell)
    try:
        result: ResultT = await wait(node, ended, timeout_s, f"the end of {name}")
    except WaitTimeoutError:
        left.add(thread)
        if not thread.is_alive():
            left.discard(thread)
        raise
    finally:
        node.alarms.cancel(alarm)
    return result
