"""The link of a process to others: every message crosses once and in order, whatever the network does.

Between two processes runs a stream each way. A message gets the next number of its stream and is sent until a packet of
the other side acknowledges it; the other side takes numbers one by one, and each once. Both write this into their
journals: what was taken together with what it caused, before the acknowledgement leaves, and what is sent together with
the firing that sends it. A process that comes back with its journal goes on with its streams. One that has lost its
journal has a larger *epoch*: its streams begin anew, and the other side says what was in flight.

What they send each other is described in :mod:`im_pnt.packets`.
"""

import json
from collections.abc import Callable

from im_core.clock import monotonic
from im_pnt.events import Observer
from im_pnt.express import Express
from im_pnt.packets import read_packet
from im_pnt.remote import MOST_NUMBER, Kind, Message, decode_message
from im_pnt.sending import SendingLink
from im_pnt.streams import WINDOW, Peer

MOST_PEERS = 1024
OVERTAKE_EVERY_S = 1.0


class Link(SendingLink):
    """Streams to and from other processes.

    Args:
        name: Name of this process.
        epoch: Larger than at any start before, unless a journal gives it back the one it had.
        accept: Takes a message from a process; returns why it is refused, empty if it is not.
        returned: Takes back a message that its receiver refused, with the reason.
        reset: Is told of a process that lost its journal: its name, and the messages to it that were in flight.
        heard: Is told of each process that gives a sign of life.
        transmit: Sends a packet to a process; it may get lost.
        observer: Is told of packets that make no sense.
        clock: Present time [s].

    Attributes:
        accept: As given; it may be set until something is heard.
    """

    def __init__(
        self,
        name: str,
        epoch: int,
        accept: Callable[[str, Message], str],
        returned: Callable[[Message, str], None],
        reset: Callable[[str, list[Message]], None],
        heard: Callable[[str], None],
        transmit: Callable[[str, str], None],
        observer: Observer | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        super().__init__(name, epoch, transmit, observer, clock)
        self.accept, self._returned, self._reset, self._heard = accept, returned, reset, heard
        self._express = Express()
        self._overtake_at = 0.0

    # Receiving. Acknowledgements leave with a later `flush` or `tick`, after the journal has been written.

    def hear(self, text: str) -> None:
        """Takes a packet; whatever it holds, it does no harm."""
        found = self._express.read(text)
        if found is not None:
            peer, message = found
            sender = peer.name
            self._stirred[sender] = peer
            self._heard(sender)
            self._taken(peer, self.accept(sender, message))
        else:
            self._hear_any(text)

    def _hear_any(self, text: str) -> None:
        packet = read_packet(text, self.name)
        if isinstance(packet, str):
            if packet:
                self._observer.troubled("", f"a packet was dropped: {packet}")
            return
        sender, epoch, known, base = packet.sender, packet.epoch, packet.known, packet.base
        peer = self.peers.get(sender)
        if peer is None:
            if len(self.peers) >= MOST_PEERS:
                text = f"a packet of {sender} was dropped: {MOST_PEERS} processes are known already"
                self._observer.troubled("", text)
                return
            peer = self.peers[sender] = Peer(sender)
        incoming = peer.incoming
        self._stirred[sender] = peer
        if known > self.epoch:
            self._overtake(known)
        if epoch < incoming.epoch:
            peer.answer = True
            return
        if epoch > incoming.epoch:
            self._begin(sender, peer, epoch, packet.journal)
        self._heard(sender)
        if known not in (0, self.epoch):
            peer.answer = True
            return
        if known and packet.ack:
            self._acknowledged(sender, peer, packet.ack)
        if base - 1 > incoming.floor:  # this process took it in a life that it does not remember
            self._move(sender, peer, base - 1)
        incoming.told(base)
        self._take(sender, peer, packet.messages)
        if known:
            self._express.keep_head(packet.head(self.name), peer)

    def _take(self, sender: str, peer: Peer, messages: list[object]) -> None:
        incoming = peer.incoming
        early = incoming.early
        for entry in messages:
            if not isinstance(entry, list) or not entry or not isinstance(entry[0], int):
                continue
            if incoming.floor < entry[0] <= incoming.floor + WINDOW:
                early[entry[0]] = entry
            else:  # it was taken already, and the acknowledgement got lost
                incoming.ack_at = 0.0
        while (fields := early.get(incoming.floor + 1)) is not None:
            try:
                message = decode_message(fields[1:])
                refusal = self.accept(sender, message)
                if not refusal:
                    self._express.keep_token(message)
            except ValueError as error:
                refusal = str(error)
            self._taken(peer, refusal)

    def _taken(self, peer: Peer, refusal: str) -> None:
        incoming = peer.incoming
        incoming.take(refusal, self._clock)
        if self.record is not None:
            why = json.dumps(refusal) if refusal else '""'
            self.record(f'["in",{peer.quoted},{incoming.floor},{why}]')

    def _acknowledged(self, sender: str, peer: Peer, ack: object) -> None:
        outgoing = peer.outgoing
        match ack:
            case [int(floor), list(refused)] if 0 <= floor <= outgoing.last:
                for entry in refused:
                    match entry:
                        case [int(number), str(why)] if number in outgoing.waiting:
                            message = outgoing.waiting.pop(number).message()
                            if self.record is not None:
                                self.record(f'["refused",{peer.quoted},{number}]')
                            self._returned(message, why)
                if outgoing.acknowledge(floor) and self.record is not None:
                    self.record(f'["acked",{peer.quoted},{floor}]')
            case _:
                text = f"{sender} acknowledged {str(ack)[:200]}, and {outgoing.last} messages were sent to it"
                self._observer.troubled("", text)

    # Lives.

    def _begin(self, node: str, peer: Peer, epoch: int, journal: bool) -> None:
        """Another life of a process: the first that is heard of, or one that has lost its journal."""
        lost = peer.incoming.epoch != 0
        self._express.forget_heads()
        peer.begin(epoch, journal)
        if self.record is not None:
            self.record(f'["begin",{peer.quoted},{epoch},{int(journal)}]')
        if not lost:
            return
        in_flight = peer.in_flight()
        self._void(peer, [number for number, message in in_flight if message.kind is not Kind.TOKEN])
        peer.outgoing.hurry()
        self._reset(node, [message for _, message in in_flight])

    def _move(self, node: str, peer: Peer, floor: int) -> None:
        if peer.incoming.floor:
            count = floor - peer.incoming.floor
            self._observer.troubled("", f"{count} messages of {node} were acknowledged, and the journal lacks them")
        peer.incoming.move(floor)
        if self.record is not None:
            self.record(f'["move",{peer.quoted},{floor}]')

    def _overtake(self, known: int) -> None:
        """A process remembers a later life of this one, whose clock must have gone back: be later still."""
        now = self._clock()
        if now < self._overtake_at or known + 1 >= MOST_NUMBER:
            return
        self._overtake_at = now + OVERTAKE_EVERY_S
        self._express.forget_heads()
        self._observer.troubled("", f"{self.name} was known in a later life than this one (clock gone back, or a twin)")
        self.epoch = known + 1
        if self.record is not None:
            self.record(f'["epoch",{self.epoch}]')
        for peer in self.peers.values():
            peer.outgoing.hurry()
