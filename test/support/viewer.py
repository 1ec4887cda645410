"""What a viewer of the page hears: changes, a line each, several of them in a message."""

import json
from collections import deque
from weakref import WeakKeyDictionary

_left = WeakKeyDictionary()


async def next_change(socket, timeout_s=60.0):
    """The next change on a socket of the page.

    Args:
        socket: The web socket of aiohttp.
        timeout_s: Longest wait [s].
    """
    left = _left.setdefault(socket, deque())
    if not left:
        left.extend(map(json.loads, (await socket.receive_str(timeout=timeout_s)).splitlines()))
    return left.popleft()
