"""The owner's end of the servo process: sends requests, hands out answers. No ROS, no waiting."""

import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core import clock
from im_core.errors import FOREIGN, ImError, LinkError
from im_core.rate_groups import RateStatistics
from im_mcs.client.time_source import TimeSource
from im_mcs.protocol.channel import ServoChannel
from im_mcs.protocol.evidence import Records
from im_mcs.protocol.requests import request_message
from im_mcs.state.table import STATES, Event, State

#: How long the listening thread waits for the bell: while a request lies there unheard, and else [s].
_UNHEARD_S, _BELL_S = 0.02, 1.0


@dataclass(frozen=True)
class ServoReply:
    """Answer to a request.

    Attributes:
        error: Why it was refused or ended badly; None if all is well.
        results: What else the answer says.
    """

    error: ImError | None
    results: dict[str, Any]


@dataclass(frozen=True)
class MotionProgress:
    """How far a motion is.

    Attributes:
        share: Of its time that has passed, 0 to 1.
        point: Point of the path that it is on its way to.
    """

    share: float
    point: int


OnReply = Callable[[ServoReply], None]
OnState = Callable[[State, dict[str, str], str, bool], None]
"""Told the state, those of groups that are not cold, why, and whether that is because the testbed was lost."""
OnProgress = Callable[[MotionProgress], None]


class ServoClient:
    """Client of the servo process: requests and the answers.

    A thread of its own waits for events and calls back from there. Heartbeats are given by :meth:`beat`, which
    whoever answers for the machine calls from where it would notice a stop: a thread of its own would hide a hang.

    Args:
        channel: Created by the caller, who owns it.
        time: The testbed's clock, asked for time when a request must be heard; closed with the client.
        on_state: Told of every change of state, of MCS or of a group.

    Attributes:
        rates: Timing of the functions of the servo loop, as told last.
    """

    def __init__(
        self, channel: ServoChannel, time: TimeSource, on_state: OnState = lambda state, groups, reason, lost: None
    ) -> None:
        self._channel = channel
        self._time = time
        self._on_state = on_state
        self.rates: tuple[RateStatistics, ...] = ()
        self._newest = channel.snapshot.record()
        self._records = Records(channel.evidence)
        self._lock = threading.Lock()
        self._next_id = 1
        self._waiting: dict[int, tuple[OnReply, OnProgress | None]] = {}
        self._heard = clock.monotonic()
        self._running = True
        self._refusal: ImError | None = None
        self._thread = threading.Thread(target=self._listen, name="mcs_events", daemon=True)
        self._thread.start()

    def send(
        self,
        event: Event,
        arguments: dict[str, Any] | None = None,
        on_reply: OnReply | None = None,
        on_progress: OnProgress | None = None,
    ) -> int:
        """Send a request; the answer comes to ``on_reply``, in another thread.

        Returns:
            Number of the request.

        Raises:
            DataError: An argument is not finite.
            LinkError: The servo process has ended, hangs, or does not take requests.
        """
        with self._lock:
            if self._refusal is not None and event is not Event.ESTOP:
                raise self._refusal
            number = self._next_id
            if self._channel.requests.empty():
                self._heard = clock.monotonic()
            self._channel.requests.send(request_message(number, event.value, arguments or {}))
            self._next_id += 1
            self._waiting[number] = (on_reply or (lambda reply: None), on_progress)
        self._time.ask()
        self._channel.bell.post()  # the listener sees to it that the servo hears it
        return number

    def snapshot(self) -> NDArray[np.void]:
        """Return the newest state of the servo, shape (); after a write cut off by death or hang, the previous one."""
        with suppress(LinkError):
            self._newest = self._channel.snapshot.read()
        return self._newest

    def state(self) -> State:
        """State of MCS in the newest snapshot."""
        return STATES[int(self.snapshot()["state"])]

    def samples(self) -> list[dict[str, Any]]:
        """Return joint samples since the last call: fields of :func:`im_mcs.protocol.samples.sample_type`, as lists."""
        return self._channel.samples.take_samples()

    def evidence(self, number: int) -> dict[str, Any] | None:
        """The last seconds before an abort, oldest tick first; None if there is no such record, or none any more.

        ``tick`` and ``stamp_ns`` have shape (m,); ``q``, ``v``, ``tau``, ``setpoint_q``, ``setpoint_v``,
        ``setpoint_a`` and ``following_error`` (m, n); ``wrench`` (m, w, 6).

        Args:
            number: As ``evidence`` in the results of a request, in the facts of a fault, or in the snapshot.
        """
        return self._records.read(number)

    def beat(self) -> None:
        """Give the servo a heartbeat; after the first one the servo watches for the next."""
        self._channel.heartbeat.beat()

    def silence_s(self) -> float:
        """For how long the servo process has given no heartbeat, wall time [s]."""
        return self._channel.heartbeat.silence_s()

    def unheard_s(self) -> float:
        """For how long the servo process has left requests lying, wall time [s]; 0 if there are none."""
        return 0.0 if self._channel.requests.empty() else clock.monotonic() - self._heard

    def give_up(self, error: ImError) -> None:
        """Answer every waiting and later request with ``error``: the servo process is gone."""
        with self._lock:
            self._refusal = error
            waiting, self._waiting = self._waiting, {}
        for on_reply, _ in waiting.values():
            on_reply(ServoReply(error, {}))

    def suspend(self, error: ImError) -> None:
        """Answer requests as :meth:`give_up` does until :meth:`resume`, for a hanging servo; call during the hang.

        An emergency stop is passed on nevertheless, and acts when the process wakes. So does the cancelling of
        everything whose sender has been told that it failed.
        """
        with self._lock, suppress(LinkError):  # of a queue that is full: what does not fit was not asked for either
            for number in self._waiting:
                self._channel.requests.send(request_message(0, Event.CANCEL.value, {"goal": number}))
        self.give_up(error)

    def resume(self) -> None:
        """The servo process has woken: requests are taken again."""
        with self._lock:
            self._refusal = None

    def close(self) -> None:
        """End the thread and answer waiting requests."""
        self._running = False
        self._channel.bell.post()
        self._thread.join()
        self._time.close()
        self.give_up(LinkError("MCS is being shut down"))

    def _listen(self) -> None:
        while self._running:
            tick = self._time.tick
            if self._channel.requests.empty():
                self._heard = clock.monotonic()
            rung = self._channel.bell.wait(_BELL_S if self._channel.requests.empty() else _UNHEARD_S)
            for message in self._channel.events.receive_all():
                try:
                    self._hand_out(message)
                except FOREIGN:  # what takes a message is foreign code: the others still get theirs
                    threading.excepthook(threading.ExceptHookArgs((*sys.exc_info(), self._thread)))
            if not rung and not self._channel.requests.empty() and self._time.tick == tick:
                self._time.ask_until(tick + 1)  # it stood still before the servo could hear the request

    def _hand_out(self, message: dict[str, Any]) -> None:
        if message["event"] == "state":
            state, groups = State(message["state"]), dict(message["groups"])
            self._on_state(state, groups, str(message["reason"]), bool(message["lost"]))
            return
        if message["event"] == "rates":
            self.rates = tuple(RateStatistics(**each) for each in message["functions"])
            return
        number = int(message["id"])
        with self._lock:
            on_reply, on_progress = self._waiting.get(number, (None, None))
            if message["event"] == "reply":
                self._waiting.pop(number, None)
        if message["event"] == "progress":
            if on_progress is not None:
                on_progress(MotionProgress(float(message["progress"]), int(message["point"])))
        elif on_reply is not None:
            error = message.get("error")
            fault = ImError.restored(error["code"], error["message"], error["facts"]) if error else None
            on_reply(ServoReply(fault, message["results"]))


def ask(
    client: ServoClient, event: Event, arguments: dict[str, Any] | None = None, timeout_s: float = 10.0
) -> ServoReply:
    """Send a request and wait for the answer; for scripts and tests.

    Raises:
        LinkError: No answer within ``timeout_s`` of wall time [s].
    """
    done = threading.Event()
    replies: list[ServoReply] = []

    def take(reply: ServoReply) -> None:
        replies.append(reply)
        done.set()

    began = clock.monotonic()
    client.send(event, arguments, take)
    if not done.wait(timeout_s):
        raise LinkError(f"the servo has not answered {event.value} within {clock.monotonic() - began:.1f} s")
    return replies[0]
