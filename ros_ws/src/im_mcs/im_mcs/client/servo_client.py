"""The owner's end of the servo process: sends requests, hands out answers. No ROS, no waiting."""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core import clock
from im_core.errors import ImError, LinkError
from im_core.testbed_link import Slot, TestbedLink
from im_mcs.client.requests import Request
from im_mcs.servo.channel import STATES, ServoChannel
from im_mcs.state import Event, State

_BELL_S = 0.02


@dataclass(frozen=True)
class Reply:
    """Answer to a request.

    Attributes:
        error: Why it was refused or ended badly; None if all is well.
        results: What else the answer says.
    """

    error: ImError | None
    results: dict[str, Any]


OnReply = Callable[[Reply], None]
OnState = Callable[[State, str], None]
OnProgress = Callable[[float, int], None]


class ServoClient:
    """Requests to the servo process and their answers.

    A thread of its own waits for events; it calls back from there.

    Args:
        channel: Created by the caller, who owns it.
        link: The testbed's clock, asked for time when a request must be heard; closed with the client.
        on_state: Told of every change of state, and why.
    """

    def __init__(
        self, channel: ServoChannel, link: TestbedLink, on_state: OnState = lambda state, reason: None
    ) -> None:
        self._channel = channel
        self._link = link
        self._on_state = on_state
        self._lock = threading.Lock()
        self._next_id = 1
        self._waiting: dict[int, tuple[OnReply, OnProgress | None]] = {}
        self._running = True
        self._closing_error: ImError | None = None
        self._thread = threading.Thread(target=self._listen, name="mcs_events", daemon=True)
        self._thread.start()

    def send(
        self,
        event: Event,
        arguments: dict[str, Any] | None = None,
        on_reply: OnReply | None = None,
        on_progress: OnProgress | None = None,
    ) -> int:
        """Send a request; its answer comes to ``on_reply``, in another thread.

        Returns:
            Number of the request.

        Raises:
            DataError: An argument is not finite.
            LinkError: The servo process has ended or does not take requests.
        """
        with self._lock:
            if self._closing_error is not None:
                raise self._closing_error
            request = Request(self._next_id, event, arguments or {})
            self._channel.requests.send(request.to_message())
            self._next_id += 1
            self._waiting[request.id] = (on_reply or (lambda reply: None), on_progress)
        self._ask_for_time()
        return request.id

    def snapshot(self) -> NDArray[np.void]:
        """Newest state of the servo, shape ()."""
        return self._channel.snapshot.read()

    def state(self) -> State:
        """State of MCS in the newest snapshot."""
        return STATES[int(self.snapshot()["state"])]

    def samples(self) -> list[dict[str, Any]]:
        """Joint states since the last call."""
        return list(self._channel.samples.receive_all())

    def give_up(self, error: ImError) -> None:
        """The servo process is gone: every request that waits is answered with ``error``, and so is every new one."""
        with self._lock:
            self._closing_error = error
            waiting, self._waiting = self._waiting, {}
        for on_reply, _ in waiting.values():
            on_reply(Reply(error, {}))

    def close(self) -> None:
        """End the thread and answer what still waits."""
        self._running = False
        self._thread.join()
        self._link.close()
        self.give_up(LinkError("MCS is being shut down"))

    def _listen(self) -> None:
        while self._running:
            tick = self._link.tick
            rung = self._channel.bell.wait(_BELL_S)
            for message in self._channel.events.receive_all():
                self._hand_out(message)
            if not rung and not self._channel.requests.empty() and self._link.tick == tick:
                # Time stood still before the servo could hear the request. Asked for by number, so that a tick which
                # begins just now is not followed by another one.
                self._link.request_until(Slot.MCS, tick + 1)
                self._renew_link()

    def _ask_for_time(self) -> None:
        self._link.request_time(Slot.MCS, 1)

    def _renew_link(self) -> None:
        """Turn to a new testbed, if the one before is gone and there is one."""
        if not self._link.physics_alive():
            with suppress(LinkError):
                link = TestbedLink.attach(self._link.instance, 0.0)
                self._link.close()
                self._link = link
                self._ask_for_time()

    def _hand_out(self, message: dict[str, Any]) -> None:
        if message["event"] == "state":
            self._on_state(State(message["state"]), str(message["reason"]))
            return
        number = int(message["id"])
        with self._lock:
            on_reply, on_progress = self._waiting.get(number, (None, None))
            if message["event"] == "reply":
                self._waiting.pop(number, None)
        if message["event"] == "progress":
            if on_progress is not None:
                on_progress(float(message["progress"]), int(message["point"]))
        elif on_reply is not None:
            error = message.get("error")
            fault = ImError.restored(error["code"], error["message"], error["facts"]) if error else None
            on_reply(Reply(fault, message["results"]))


def ask(client: ServoClient, event: Event, arguments: dict[str, Any] | None = None, timeout_s: float = 10.0) -> Reply:
    """Send a request and wait for its answer; for scripts and tests.

    Raises:
        LinkError: No answer within ``timeout_s`` of wall time [s].
    """
    done = threading.Event()
    replies: list[Reply] = []

    def take(reply: Reply) -> None:
        replies.append(reply)
        done.set()

    began = clock.monotonic()
    client.send(event, arguments, take)
    if not done.wait(timeout_s):
        raise LinkError(f"{event.value} was not answered within {clock.monotonic() - began:.1f} s")
    return replies[0]
