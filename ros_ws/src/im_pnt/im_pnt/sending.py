"""The sending half of a link: numbers messages, sends them until they are acknowledged, and acknowledges."""

import json
from collections.abc import Callable

from im_core.clock import monotonic
from im_pnt.errors import NetError
from im_pnt.events import Observer
from im_pnt.remote import Message, encode_message
from im_pnt.streams import WINDOW, Peer

MOST_PACKET_MESSAGES = 64
MANY_IN_FLIGHT = 10_000

Record = Callable[[str], None]
"""Takes an entry for the journal, as JSON; it is written before anything leaves."""


class SendingLink:
    """Streams to other processes; what comes from them is :class:`im_pnt.link.Link`'s.

    Args:
        name: Name of this process.
        epoch: Larger than at any start before, unless a journal gives it back the one it had.
        transmit: Sends a packet to a process; it may get lost.
        observer: Is told of streams that wait in vain.
        clock: Present time [s].

    Attributes:
        peers: The other processes, by name.
        record: Takes an entry for the journal; None: no journal is kept.
        held: Whether something is still to be written to the journal; nothing leaves then.
    """

    def __init__(
        self,
        name: str,
        epoch: int,
        transmit: Callable[[str, str], None],
        observer: Observer | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.name, self.epoch = name, epoch
        self.record: Record | None = None
        self.held: Callable[[], bool] = lambda: False
        self.peers: dict[str, Peer] = {}
        self._quoted = json.dumps(name)
        self._transmit = transmit
        self._observer, self._clock = observer or Observer(), clock
        self._stirred: dict[str, Peer] = {}

    def send(self, node: str, message: Message) -> None:
        """Numbers a message; it leaves with the next :meth:`flush`, and arrives once.

        Raises:
            NetError: Its payload is not JSON data.
        """
        try:
            encoded = encode_message(message)
        except (TypeError, ValueError, RecursionError) as error:
            raise NetError(f"{message} is not JSON data: {error}", net=message.net) from error
        peer = self.peers.get(node)
        if peer is None:
            peer = self.peers[node] = Peer(node)
        outgoing = peer.outgoing
        sent = outgoing.add(encoded)
        if self.record is not None:
            self.record(f'["out",{peer.quoted},{sent.text}]')
        if outgoing.last <= outgoing.floor + WINDOW:
            peer.fresh.append(sent)
            self._stirred[node] = peer
        elif len(outgoing.waiting) % MANY_IN_FLIGHT == 0:
            self._observer.troubled("", f"{len(outgoing.waiting)} messages wait for {node}")

    def forget(self, request_id: str) -> None:
        """Sends nothing more about a request."""
        for peer in self.peers.values():
            self._void(peer, [n for n, message in peer.in_flight() if message.request_id == request_id])

    def flush(self) -> None:
        """Sends what is new, and the acknowledgements that are due."""
        if not self._stirred or self.held():
            return
        now = self._clock()
        stirred, self._stirred = self._stirred, {}
        for node, peer in stirred.items():
            texts: list[str] = []
            if peer.fresh:
                for sent in peer.fresh:
                    sent.due = now + sent.interval
                    texts.append(sent.text)
                peer.fresh.clear()
            if texts or peer.answer or peer.incoming.owes(now):
                self._send_packets(node, peer, texts, now)

    def tick(self) -> None:
        """Sends again what has not been acknowledged in time, and acknowledges; call it every 0.05 s or so."""
        if self.held():
            return
        self.flush()
        now = self._clock()
        for node, peer in self.peers.items():
            texts = peer.outgoing.due(now) if peer.outgoing.waiting else []
            if texts or peer.incoming.owes(now):
                self._send_packets(node, peer, texts, now)

    def _send_packets(self, node: str, peer: Peer, texts: list[str], now: float) -> None:
        incoming = peer.incoming
        peer.answer = False
        ack = incoming.acknowledgement() if incoming.ack_at is not None and incoming.owes(now) else "0"
        journal = 0 if self.record is None else 1
        life = f"[{self._quoted},{self.epoch},{journal},{peer.quoted},{incoming.epoch}"
        head = f"{life},{peer.outgoing.floor + 1},{ack}"
        if len(texts) == 1:
            self._transmit(node, f"{head},{texts[0]}]")
            return
        for first in range(0, len(texts) or 1, MOST_PACKET_MESSAGES):
            self._transmit(node, ",".join((head, *texts[first : first + MOST_PACKET_MESSAGES])) + "]")

    def _void(self, peer: Peer, numbers: list[int]) -> None:
        for number in numbers:
            peer.outgoing.void(number)
            if self.record is not None:
                self.record(f'["void",{peer.quoted},{number}]')

    def in_flight(self) -> dict[str, list[Message]]:
        """Returns the messages that are not acknowledged, by process."""
        flights = {node: [message for _, message in peer.in_flight()] for node, peer in self.peers.items()}
        return {node: messages for node, messages in flights.items() if messages}

    def keeps_journal(self, node: str) -> bool:
        """Whether a process has said that it keeps a journal."""
        return node in self.peers and self.peers[node].keeps_journal

    def idle(self) -> bool:
        """Whether everything is acknowledged, here and there."""
        return not any(peer.outgoing.waiting or peer.incoming.ack_at is not None for peer in self.peers.values())
