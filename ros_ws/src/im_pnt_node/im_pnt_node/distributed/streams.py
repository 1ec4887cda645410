"""The two streams between the own process and another one: unacknowledged messages, and taken ones.

A link tells its journal what happens to them as one of :data:`.entries.LinkEntry`, before it is done;
:meth:`Peer.apply` does it, now and when a journal is replayed.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field

from im_pnt_node.distributed.entries import (
    IncarnationBegun,
    Json,
    MessageRefused,
    MessagesAcknowledged,
    MessageSent,
    MessageTaken,
    MessageVoided,
    NumbersSkipped,
    PeerEntry,
)
from im_pnt_node.distributed.packets import VOID, Message, decode_message, numbered

RESEND_AFTER_S = 0.25
RESEND_AT_MOST_S = 2.0
WINDOW = 1024
"""Messages that may be on their way to one process at a time."""
ACK_AFTER_S = 0.05
ACK_AFTER_MESSAGES = 64
"""An acknowledgement leaves so long after a message, or after so many."""
MOST_REFUSALS = 64
"""Refusals told in one acknowledgement."""
MOST_REASON = 500
"""Characters of a refusal."""


@dataclass(slots=True)
class Sent:
    """Message without an acknowledgement.

    Attributes:
        text: The message with its number, as JSON.
        due: When it is sent next [s].
        interval: Time between this repetition and the next [s].
    """

    text: Json
    due: float = 0.0
    interval: float = RESEND_AFTER_S

    def message(self) -> Message:
        """Return the message."""
        return decode_message(json.loads(self.text)[1:])

    def again(self, now: float) -> str:
        """Return the text to send now, and note the time of the next repetition."""
        self.due, self.interval = now + self.interval, min(2.0 * self.interval, RESEND_AT_MOST_S)
        return self.text


@dataclass(slots=True)
class Outgoing:
    """The stream to another process.

    Attributes:
        last: Number of the last message.
        floor: Everything up to this number is acknowledged.
        waiting: Messages not acknowledged, by number, in order.
        question: What asks the other process how far it has taken, as long as this one, back from its journal, has not
            been told: a message that it has taken long ago. Meanwhile none leaves whose number came after the journal.
        asked_at: Number of the last message when the question was put.
    """

    last: int = 0
    floor: int = 0
    waiting: dict[int, Sent] = field(default_factory=dict)
    question: Sent | None = None
    asked_at: int = 0

    def ask(self) -> None:
        """Ask the other process for the last taken number: the own process may have forgotten later ones."""
        self.question, self.asked_at = Sent(numbered(self.floor, VOID)), self.last

    def most(self) -> int:
        """Return the largest possible number under way."""
        window = self.floor + WINDOW
        return window if self.question is None else min(window, self.asked_at)

    def acknowledge(self, floor: int) -> None:
        """Drop all messages up to a number."""
        for number in range(self.floor + 1, floor + 1):
            self.waiting.pop(number, None)
        self.floor = max(floor, self.floor)

    def void(self, number: int) -> None:
        """Replace an unneeded message by an empty one."""
        self.waiting[number].text = numbered(number, VOID)

    def due(self, now: float) -> list[str]:
        """Return the messages to send now, oldest first, and note the times of the next repetitions."""
        texts: list[str] = []
        end = self.most()
        if self.question is not None and now >= self.question.due:
            texts.append(self.question.again(now))
        for number, sent in self.waiting.items():
            if number > end:
                break
            if now >= sent.due:
                texts.append(sent.again(now))
        return texts

    def hurry(self) -> None:
        """Has everything sent again at once."""
        for sent in (*self.waiting.values(), *([self.question] if self.question is not None else [])):
            sent.due, sent.interval = 0.0, RESEND_AFTER_S


@dataclass(slots=True)
class Incoming:
    """The stream from another process.

    Attributes:
        epoch: Its epoch, 0 if it was never heard.
        floor: Everything up to this number was taken or refused.
        refused: Why numbers were refused, until the sender has been told.
        early: Messages that came before others of smaller numbers; not taken yet.
        untold: Messages taken since the last acknowledgement.
        ack_at: When an acknowledgement is due [s], None: nothing to tell.
        parted: Whether this process has begun another incarnation and has not heard the sender since: the sender may
            have counted further than this process remembers.
    """

    epoch: int = 0
    floor: int = 0
    refused: dict[int, str] = field(default_factory=dict)
    early: dict[int, list[object]] = field(default_factory=dict)
    untold: int = 0
    ack_at: float | None = None
    parted: bool = False

    def begin(self, epoch: int) -> None:
        """Begin anew with another epoch of the sender."""
        self.epoch, self.floor, self.untold, self.ack_at, self.parted = epoch, 0, 0, None, False
        self.refused.clear()
        self.early.clear()

    def move(self, floor: int) -> None:
        """Stop waiting for messages up to a number."""
        self.floor, self.parted = floor, False
        self.early = {number: fields for number, fields in self.early.items() if number > floor}

    def take_message(self, refusal: str, clock: Callable[[], float]) -> None:
        """Takes, or refuses, the next number; the sender is told soon."""
        self.floor += 1
        if self.early:
            self.early.pop(self.floor, None)
        if refusal:
            self.refused[self.floor] = refusal[:MOST_REASON]
        self.untold += 1
        if self.untold >= ACK_AFTER_MESSAGES:
            self.ack_at = 0.0
        elif self.ack_at is None:
            self.ack_at = clock() + ACK_AFTER_S

    def owes(self, now: float) -> bool:
        """Whether an acknowledgement is due."""
        return self.ack_at is not None and now >= self.ack_at

    def told(self, base: int) -> None:
        """Forget refusals known to the sender: the sender waits for none before ``base``."""
        if self.refused:
            self.refused = {number: why for number, why in self.refused.items() if number >= base}

    def acknowledgement(self) -> str:
        """Return the acknowledgement for the sender, as JSON."""
        self.untold, self.ack_at = 0, None
        if not self.refused:
            return f"[{self.floor},[]]"
        numbers = sorted(self.refused)
        listed = [[number, self.refused[number]] for number in numbers[:MOST_REFUSALS]]
        floor = numbers[MOST_REFUSALS] - 1 if len(numbers) > MOST_REFUSALS else self.floor
        return json.dumps([floor, listed], separators=(",", ":"))


class Peer:
    """Another process, with the streams to and from the process.

    Attributes:
        name: As given.
        quoted: Its name as JSON.
        outgoing: The stream to it.
        incoming: The stream from it.
        fresh: Messages that were not sent yet.
        keeps_journal: Whether it has said that it keeps a journal.
        answered_at: When it last acknowledged something, or something began to wait for that [s]; None: nothing waits.
        unreached: Whether it was said that no message reaches it.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.quoted = json.dumps(name)
        self.outgoing = Outgoing()
        self.incoming = Incoming()
        self.fresh: list[Sent] = []
        self.keeps_journal = False
        self.answered_at: float | None = None
        self.unreached = False

    def in_flight(self) -> list[tuple[int, Message]]:
        """Return the unacknowledged messages, with the numbers."""
        messages = ((number, sent.message()) for number, sent in self.outgoing.waiting.items())
        return [(number, message) for number, message in messages if message.event is not None]

    def apply(self, entry: PeerEntry, clock: Callable[[], float]) -> None:
        """Apply an entry.

        Args:
            entry: What happens to one of the streams.
            clock: Present time [s]; what is owed to the process is due soon after it.

        Raises:
            ValueError: It does not fit the streams.
        """
        incoming, outgoing = self.incoming, self.outgoing
        if isinstance(entry, MessageTaken):  # this and the next come with every message: no match for them
            if entry.number == incoming.floor + 1:
                incoming.take_message(entry.refusal, clock)
                return
        elif isinstance(entry, MessageSent) and entry.number == outgoing.last + 1:
            outgoing.last = entry.number
            outgoing.waiting[entry.number] = Sent(entry.text)
            return
        match entry:
            case MessagesAcknowledged(_, floor) if floor <= outgoing.last:
                outgoing.acknowledge(floor)
            case MessageRefused(_, number) if number in outgoing.waiting:
                del outgoing.waiting[number]
            case MessageVoided(_, number) if number in outgoing.waiting:
                outgoing.void(number)
            case IncarnationBegun(_, epoch, journal):
                self.keeps_journal = journal
                incoming.begin(epoch)
            case NumbersSkipped(_, floor) if floor >= incoming.floor:
                incoming.move(floor)
            case _:
                raise ValueError(f"{entry} does not fit the stream")
