"""Messages between nets of different processes, each delivered once whatever the transport loses, doubles or swaps.

The sender numbers its messages to each receiver and repeats them until they are acknowledged; the receiver accepts a
number once and acknowledges it every time. ``epoch`` is the incarnation of the sender: a larger one begins a new count,
a smaller one is a message from an earlier life and is refused.
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass, field

from im_core.errors import ImError


class Kind(enum.IntEnum):
    """What a message is, numbered as in ``im_msgs/msg/Token``."""

    TOKEN = 0
    REQUEST = 1
    REPLY = 2


@dataclass(frozen=True, slots=True)
class Message:
    """A token, request or reply for a net of another process.

    Attributes:
        kind: What it is.
        net: Net that gets it.
        place: Place that is marked.
        request_id: Of a request and its reply.
        caller_net: Net that asks, for a request.
        caller_transition: Transition that waits, for a request.
        command_id: Command it is done for.
        error: Why a request failed, for its reply.
        payload: Arguments or results, as plain JSON data.
    """

    kind: Kind
    net: str
    place: str
    request_id: str = ""
    caller_net: str = ""
    caller_transition: str = ""
    command_id: int = 0
    error: ImError | None = None
    payload: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Envelope:
    """A message on its way."""

    sender: str
    receiver: str
    epoch: int
    sequence: int
    message: Message


@dataclass(frozen=True, slots=True)
class Ack:
    """Acknowledges one envelope; ``refusal`` says why it was not accepted, empty if it was."""

    receiver: str
    sender: str
    epoch: int
    sequence: int
    receiver_epoch: int
    refusal: str


@dataclass(slots=True)
class _Sent:
    envelope: Envelope
    due: float
    interval: float


class Sender:
    """Numbers messages and repeats them until they are acknowledged.

    Args:
        name: Node that sends.
        epoch: Its incarnation; larger after every restart.
        resend_after: Time without acknowledgement after which a message is repeated [s]; doubles each time.
        resend_at_most: Longest time between repetitions [s].
    """

    def __init__(self, name: str, epoch: int, resend_after: float = 0.25, resend_at_most: float = 2.0) -> None:
        self.name = name
        self.epoch = epoch
        self._resend_after, self._resend_at_most = resend_after, resend_at_most
        self._count: dict[str, int] = {}
        self._sent: dict[tuple[str, int], _Sent] = {}

    def send(self, receiver: str, message: Message, now: float) -> Envelope:
        """Numbers a message; the envelope is to be transmitted at once.

        Args:
            receiver: Node that gets it.
            message: What it gets.
            now: Present time [s].
        """
        sequence = self._count[receiver] = self._count.get(receiver, 0) + 1
        envelope = Envelope(self.name, receiver, self.epoch, sequence, message)
        self._sent[receiver, sequence] = _Sent(envelope, now + self._resend_after, self._resend_after)
        return envelope

    def acknowledged(self, ack: Ack) -> Message | None:
        """Takes an acknowledgement; returns the message if it was refused, None if accepted or known already."""
        if ack.epoch != self.epoch or ack.sender != self.name:
            return None
        sent = self._sent.pop((ack.receiver, ack.sequence), None)
        return sent.envelope.message if sent is not None and ack.refusal else None

    def due(self, now: float) -> list[Envelope]:
        """Returns the envelopes that are to be transmitted again, oldest first."""
        again: list[Envelope] = []
        for sent in self._sent.values():
            if now >= sent.due:
                sent.interval = min(2.0 * sent.interval, self._resend_at_most)
                sent.due = now + sent.interval
                again.append(sent.envelope)
        return again

    def forget(self, request_id: str) -> None:
        """Gives up everything about a request that nobody waits for any more."""
        self._sent = {key: s for key, s in self._sent.items() if s.envelope.message.request_id != request_id}

    def unacknowledged(self) -> int:
        """Returns how many messages wait for their acknowledgement."""
        return len(self._sent)


class _Seen:
    """Numbers received from one incarnation of a sender: all up to ``floor``, and those in ``above``."""

    MOST = 4096

    def __init__(self, epoch: int) -> None:
        self.epoch = epoch
        self.floor = 0
        self.above: set[int] = set()
        self.refusals: dict[int, str] = {}

    def __contains__(self, sequence: int) -> bool:
        return sequence <= self.floor or sequence in self.above

    def add(self, sequence: int, refusal: str) -> None:
        self.above.add(sequence)
        if refusal:
            self.refusals[sequence] = refusal
        if len(self.above) > self.MOST:
            self.floor = min(self.above)
        while self.floor + 1 in self.above:
            self.floor += 1
        self.above = {number for number in self.above if number > self.floor} if len(self.above) > 64 else self.above
        while len(self.refusals) > self.MOST:
            del self.refusals[next(iter(self.refusals))]


class Receiver:
    """Accepts each message once.

    Args:
        name: Node that receives.
        epoch: Its incarnation.
        accept: Takes a message that is new; returns why it is refused, empty if it is not.
    """

    def __init__(self, name: str, epoch: int, accept: Callable[[str, Message], str]) -> None:
        self.name = name
        self.epoch = epoch
        self._accept = accept
        self._seen: dict[str, _Seen] = {}

    def receive(self, envelope: Envelope) -> Ack:
        """Takes an envelope, delivers its message if it is new, and returns the acknowledgement to send."""
        seen = self._seen.get(envelope.sender)
        if seen is None or envelope.epoch > seen.epoch:
            seen = self._seen[envelope.sender] = _Seen(envelope.epoch)
        if envelope.epoch < seen.epoch:
            refusal = f"sent by an earlier incarnation of {envelope.sender}"
        elif envelope.sequence in seen:
            refusal = seen.refusals.get(envelope.sequence, "")
        else:
            refusal = self._accept(envelope.sender, envelope.message)
            seen.add(envelope.sequence, refusal)
        return Ack(self.name, envelope.sender, envelope.epoch, envelope.sequence, self.epoch, refusal)
