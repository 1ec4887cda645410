"""Waits without end, in slices: a Ctrl-C that comes just before the main thread waits in C is heard after a slice."""

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from typing import TypeVar

ItemT = TypeVar("ItemT")

_SLICE_S = 0.5


def wait_for(event: threading.Event, timeout: float | None = None) -> bool:
    """Wait for an event; return whether the event is set.

    Args:
        event: The event.
        timeout: Longest wait [s]; None: without end.
    """
    deadline = None if timeout is None else time.monotonic() + timeout
    while deadline is None or deadline - time.monotonic() > _SLICE_S:
        if event.wait(_SLICE_S):
            return True
    return event.wait(max(0.0, deadline - time.monotonic()))


def next_of(items: "queue.Queue[ItemT] | queue.SimpleQueue[ItemT]", look: Callable[[], None] = lambda: None) -> ItemT:
    """Take the next item of a queue.

    Args:
        items: The queue.
        look: Called after each slice of the wait; what it raises ends the wait.
    """
    while True:
        with contextlib.suppress(queue.Empty):
            return items.get(timeout=_SLICE_S)
        look()
