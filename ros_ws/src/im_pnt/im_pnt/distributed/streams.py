"""The two streams between this process and another one: what was sent and is not acknowledged, and what was taken."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from im_pnt.remote import VOID, Kind, Message, decode_message, encode_message, is_number

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
    """A message that is not acknowledged.

    Attributes:
        text: The message with its number, as JSON.
        due: When it is sent next [s].
        interval: Time between this repetition and the next [s].
    """

    text: str
    due: float = 0.0
    interval: float = RESEND_AFTER_S

    def message(self) -> Message:
        """Returns the message."""
        return decode_message(json.loads(self.text)[1:])


@dataclass(slots=True)
class Outgoing:
    """The stream to another process.

    Attributes:
        last: Number of the last message.
        floor: Everything up to this number is acknowledged.
        waiting: Messages not acknowledged, by number, in order.
    """

    last: int = 0
    floor: int = 0
    waiting: dict[int, Sent] = field(default_factory=dict)

    def add(self, encoded: str) -> Sent:
        """Numbers a message."""
        self.last += 1
        sent = self.waiting[self.last] = Sent(f"[{self.last},{encoded}]")
        return sent

    def acknowledge(self, floor: int) -> bool:
        """Drops all messages up to a number; returns whether there were any."""
        if floor <= self.floor:
            return False
        for number in range(self.floor + 1, floor + 1):
            self.waiting.pop(number, None)
        self.floor = floor
        return True

    def void(self, number: int) -> None:
        """Puts nothing in the place of a message that nobody needs any more."""
        self.waiting[number].text = f"[{number},{encode_message(VOID)}]"

    def due(self, now: float) -> list[str]:
        """Returns the messages to send now, oldest first, and notes when they are sent again."""
        texts: list[str] = []
        end = self.floor + WINDOW
        for number, sent in self.waiting.items():
            if number > end:
                break
            if now >= sent.due:
                sent.due, sent.interval = now + sent.interval, min(2.0 * sent.interval, RESEND_AT_MOST_S)
                texts.append(sent.text)
        return texts

    def hurry(self) -> None:
        """Has everything sent again at once."""
        for sent in self.waiting.values():
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
    """

    epoch: int = 0
    floor: int = 0
    refused: dict[int, str] = field(default_factory=dict)
    early: dict[int, list[object]] = field(default_factory=dict)
    untold: int = 0
    ack_at: float | None = None

    def begin(self, epoch: int) -> None:
        """Begins anew with another epoch of the sender."""
        self.epoch, self.floor, self.untold, self.ack_at = epoch, 0, 0, None
        self.refused.clear()
        self.early.clear()

    def move(self, floor: int) -> None:
        """Waits for nothing up to a number any more."""
        self.floor = floor
        self.early = {number: fields for number, fields in self.early.items() if number > floor}

    def take(self, refusal: str, clock: Callable[[], float]) -> None:
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
        """Forgets refusals that the sender has been told of: it waits for none before ``base``."""
        if self.refused:
            self.refused = {number: why for number, why in self.refused.items() if number >= base}

    def acknowledgement(self) -> str:
        """Returns what to tell the sender, as JSON."""
        self.untold, self.ack_at = 0, None
        if not self.refused:
            return f"[{self.floor},[]]"
        numbers = sorted(self.refused)
        listed = [[number, self.refused[number]] for number in numbers[:MOST_REFUSALS]]
        floor = numbers[MOST_REFUSALS] - 1 if len(numbers) > MOST_REFUSALS else self.floor
        return json.dumps([floor, listed], separators=(",", ":"))


class Peer:
    """Another process, with the streams to and from it.

    Args:
        name: Its name.

    Attributes:
        name: As given.
        quoted: Its name as JSON.
        outgoing: The stream to it.
        incoming: The stream from it.
        fresh: Messages that were not sent yet.
        answer: Whether it must hear of this process, even if there is nothing to tell.
        keeps_journal: Whether it has said that it keeps a journal.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.quoted = json.dumps(name)
        self.outgoing = Outgoing()
        self.incoming = Incoming()
        self.fresh: list[Sent] = []
        self.answer = False
        self.keeps_journal = False

    def begin(self, epoch: int, keeps_journal: bool) -> None:
        """Begins anew with another life of the process."""
        self.keeps_journal = keeps_journal
        self.incoming.begin(epoch)

    def in_flight(self) -> list[tuple[int, Message]]:
        """Returns the messages not acknowledged, with their numbers."""
        messages = ((number, sent.message()) for number, sent in self.outgoing.waiting.items())
        return [(number, message) for number, message in messages if message.kind is not Kind.VOID]

    def state(self) -> dict[str, object]:
        """Returns what is to be remembered, as JSON data."""
        refused = [[number, reason] for number, reason in self.incoming.refused.items()]
        waiting = [json.loads(sent.text) for sent in self.outgoing.waiting.values()]
        heard = [self.incoming.epoch, self.incoming.floor, refused]
        return {"heard": heard, "last": self.outgoing.last, "waiting": waiting, "journal": self.keeps_journal}

    def replay(self, kind: str, rest: list[object]) -> None:
        """Repeats what an entry of the journal tells.

        Raises:
            ValueError: It is none, or does not fit.
        """
        incoming, outgoing = self.incoming, self.outgoing
        match [kind, *rest]:
            case ["out", [int(number), *fields]] if number == outgoing.last + 1:
                outgoing.add(encode_message(decode_message(fields)))
            case ["acked", int(floor)] if floor <= outgoing.last:
                outgoing.acknowledge(floor)
            case ["refused", int(number)] if number in outgoing.waiting:
                del outgoing.waiting[number]
            case ["void", int(number)] if number in outgoing.waiting:
                outgoing.void(number)
            case ["in", int(number), str(refusal)] if number == incoming.floor + 1:
                incoming.take(refusal, lambda: 0.0)
            case ["begin", int(epoch), int(journal)]:
                self.begin(epoch, journal != 0)
            case ["move", int(floor)] if floor > incoming.floor:
                incoming.move(floor)
            case _:
                raise ValueError(f"{kind} {str(rest)[:200]} does not fit the stream")

    @classmethod
    def restored(cls, name: str, state: Mapping[str, object]) -> "Peer":
        """Makes one of what was remembered.

        Raises:
            ValueError: It is none.
        """
        match state:
            case {"heard": [int(epoch), int(floor), list(refused)], "last": int(last), "waiting": list(waiting)}:
                peer = cls(name)
                peer.incoming.epoch, peer.incoming.floor = epoch, floor
                peer.incoming.ack_at = 0.0 if floor else None
                peer.incoming.refused = {int(number): str(reason) for number, reason in refused}
                peer.outgoing.last = last
                peer.keeps_journal = state.get("journal") is True
                for number, *fields in waiting:
                    peer.outgoing.waiting[number] = Sent(f"[{number},{encode_message(decode_message(fields))}]")
                peer.outgoing.floor = next(iter(peer.outgoing.waiting), last + 1) - 1
                if is_number(last) and is_number(epoch) and is_number(floor):
                    return peer
        raise ValueError(f"{str(state)[:200]} is no state of a stream")
