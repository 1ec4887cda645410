"""Answers with a client not yet reached by DDS: sent again until reached.

A client may have found its server before the server has found the reader of the client's answers: discovery is under
way, which takes long on a busy computer. ``rmw_fastrtps`` then gives up, rclpy warns, and the client waits for ever for
what was carried out (https://github.com/ros2/rclcpp/issues/2760); the same answer can be sent again
(https://github.com/ros2/rmw_fastrtps/pull/467).

Before it gives up, ``rmw_fastrtps`` waits for the ``max_blocking_time`` of the answers' writer, and holds up the whole
process: clients that call and are destroyed at once would stop the loop with 100 ms each, the value by default. In the
Fast DDS profiles of the machine (``im_bringup/config``) that time is zero, so that sending in vain costs nothing.
"""

import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.timer import Timer

from im_core import clock
from im_core.errors import LinkError
from im_core.ros.peers.client_identity import sender_of

#: How often it is looked whether an answer is due, and after how long the first is sent again, each next after twice
#: the time [s].
LOOK_S = 0.02
#: How long an answer is kept [s], and how many are, of all services and clients of a node.
KEPT_S = 15.0
MOST_KEPT = 200


def unreached(error: Exception) -> bool:
    """Return whether sending an answer failed because the client is not reached; see :class:`LateAnswers`."""
    return isinstance(error, SystemError) and isinstance(error.__cause__, RuntimeWarning)


@dataclass
class _Waiting:
    """Answers of one server to one client, in order."""

    since: float
    due: float
    wait_s: float = LOOK_S
    answers: deque[Callable[[], None]] = field(default_factory=deque)


class LateAnswers:
    """Answers of a node waiting for unreached clients; called in the node's loop.

    What rclpy warns of is an error from now on: nothing else tells whoever sends that an answer was not sent.

    Args:
        node: The node, which need not be made yet.
        lost: Is told of an answer that was given up: whose it was, what is wrong, and for whom, as
            :func:`im_core.ros.peers.client_identity.sender_of` says.
    """

    def __init__(self, node: Node, lost: Callable[[str, LinkError, str], None]) -> None:
        warnings.filterwarnings("error", message="failed to send response", category=RuntimeWarning)
        self._node, self._lost = node, lost
        self._waiting: dict[tuple[str, str], _Waiting] = {}
        self._timer: Timer | None = None

    def send(self, what: str, header: Any, answer: Callable[[], None]) -> None:
        """Send an answer, behind waiting answers of the same server to the same client.

        Args:
            what: Whose answer it is, as in ``service /dom/put``.
            header: Of the request.
            answer: Sends it.

        Raises:
            Exception: What sending it raised, other than that its client is not reached, or its server destroyed.
        """
        if not self._waiting or (what, sender_of(header)) not in self._waiting:
            try:
                answer()
                return
            except InvalidHandle:  # the server was destroyed: none of its clients waits for an answer
                return
            except SystemError as error:
                if not unreached(error):
                    raise
        self.keep(what, header, answer)

    def keep(self, what: str, header: Any, answer: Callable[[], None]) -> None:
        """Send an answer when the client is reached; arguments as of :meth:`send`."""
        now = clock.monotonic()
        waiting = self._waiting.setdefault((what, sender_of(header)), _Waiting(now, now + LOOK_S))
        waiting.answers.append(answer)
        if sum(len(each.answers) for each in self._waiting.values()) > MOST_KEPT:
            self._make_room()
        if self._timer is None:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = self._node.create_timer(LOOK_S, self._send_due, clock=steady)
        elif self._timer.is_canceled():
            self._timer.reset()

    def _make_room(self) -> None:
        """Give up the oldest answer of the client for which most wait; of several such clients, of the first."""
        what, client = most = max(self._waiting, key=lambda each: len(self._waiting[each].answers))
        self._waiting[most].answers.popleft()
        if not self._waiting[most].answers:
            del self._waiting[most]
        self._lost(what, LinkError(f"more than {MOST_KEPT} answers wait for clients that are not reached"), client)

    def _send_due(self) -> None:
        """Send all due answers."""
        assert self._timer is not None, "it has called this"
        now = clock.monotonic()
        for (what, client), waiting in tuple(self._waiting.items()):
            if waiting.due > now:
                continue
            if self._reached(what, client, waiting):
                del self._waiting[what, client]
            else:
                self._put_off(what, client, waiting)
        if not self._waiting:
            self._timer.cancel()

    def _reached(self, what: str, client: str, waiting: _Waiting) -> bool:
        """Send all answers waiting for a client; return False if the client is not reached."""
        while waiting.answers:
            try:
                waiting.answers[0]()
            except Exception as error:  # the other answers go on
                if unreached(error):
                    return False
                self._lost(what, LinkError(f"an answer could not be sent: {error}"), client)
            waiting.answers.popleft()
        return True

    def _put_off(self, what: str, client: str, waiting: _Waiting) -> None:
        now = clock.monotonic()
        waited_s = now - waiting.since
        if waited_s < KEPT_S:
            waiting.wait_s *= 2.0
            waiting.due = min(now + waiting.wait_s, waiting.since + KEPT_S)
            return
        del self._waiting[what, client]
        words = (
            f"DDS has not reached the client for {waited_s:.0f} s: it has ended, is busy, or asks for a quality of "
            "service that no answer has (durability must be VOLATILE)"
        )
        for _ in waiting.answers:
            self._lost(what, LinkError(words), client)
