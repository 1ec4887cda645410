"""The link of a process to others: every message crosses once and in order, on any network.

Between two processes runs a stream each way. A message gets the next number of its stream and is sent until a packet of
the other side acknowledges it; the other side takes numbers one by one, and each once. Both write this into their
journals: what was taken together with what it caused, before the acknowledgement leaves, and what is sent together with
the firing that sends it. A process that comes back with its journal goes on with its streams. One that has lost its
journal has a larger *epoch*: its streams begin anew, and the other side says what was in flight. One that comes back
with an old copy of its journal is told so by the numbers that the others remember; it begins anew too, and says so.

A packet is believed that knows the present epoch of its receiver, which holds a secret; any other is answered and does
nothing else. So who cannot read what the processes send each other cannot forge, hide or block anything. Who can read
it can: against them only the operating system's walls help, or the middleware's.

What they send each other is described in :mod:`im_pnt_node.distributed.packets`.
"""

import json
from collections.abc import Callable

from im_core.clock import monotonic, wall
from im_pnt.errors import NetError
from im_pnt.execution.events import TokenArrived
from im_pnt.execution.notification import Observer
from im_pnt_node.distributed.entries import (
    EpochRaised,
    IncarnationBegun,
    LinkEntry,
    MessageRefused,
    MessagesAcknowledged,
    MessageSent,
    MessageTaken,
    MessageVoided,
    NumbersSkipped,
    PeerEntry,
)
from im_pnt_node.distributed.packets import (
    MOST_EPOCH,
    REMEMBERED,
    Message,
    Packet,
    began_at,
    decode_message,
    encode_message,
    new_epoch,
    numbered,
    read_packet,
    with_hold,
)
from im_pnt_node.distributed.streams import WINDOW, Peer, Sent

MOST_PEERS = 1024
MOST_PACKET_MESSAGES = 64
MANY_IN_FLIGHT = 10_000
OVERTAKE_EVERY_S = 1.0
MOST_STRANGERS = 64
"""Processes answered at a time that have not shown that they know this one."""
MANY_UNPROVED = 20
REPORT_EVERY_S = 5.0
MOST_AHEAD_S = 86_400.0
"""Tell of an incarnation that begins later than this from now: a clock is wrong, or the epoch is made up."""
UNREACHED_S = 10.0
"""A process that acknowledges nothing for so long, while messages to it wait, is told of."""
MOST_TOKENS = 4096
_NO_ACKNOWLEDGEMENT = ",0,["


class Express:
    """Express lane of a link: the next token from a known process is recognised by the spelling.

    Nearly every packet between running nets is ``[sender, epoch, journal, receiver, known, base, 0, [number, net,
    token]]``, and only the number differs from the packet before. What comes before and after it is kept here as text
    when it was read in full, so that it need not be read as JSON again: a tenth of a round trip's CPU time. Every
    packet that is not spelled so goes the long way.
    """

    def __init__(self) -> None:
        self._peers: dict[str, Peer] = {}
        self._heads: dict[str, str] = {}
        self._tokens: dict[str, Message] = {}

    def read(self, text: str) -> tuple[Peer, Message] | None:
        """Read a packet; return the sender and the next token of the stream, None for any other packet."""
        head, _, rest = text.partition(_NO_ACKNOWLEDGEMENT)
        number, _, token = rest.partition(",")
        peer, message = self._peers.get(head), self._tokens.get(token)
        if peer is None or message is None:
            return None
        incoming = peer.incoming
        if incoming.early or incoming.refused or number != str(incoming.floor + 1):
            return None
        return peer, message

    def keep_head(self, head: str, peer: Peer) -> None:
        """Keep the beginning of a packet of a process, up to ``base``, for the present incarnations of both."""
        self._peers.pop(self._heads.get(peer.name, ""), None)
        self._heads[peer.name] = head
        self._peers[head] = peer

    def keep_token(self, message: Message) -> None:
        """Keep the spelling of an accepted token."""
        event = message.event
        if isinstance(event, TokenArrived) and event.context is None and len(self._tokens) < MOST_TOKENS:
            self._tokens[f"{encode_message(message)}]]"] = message

    def forget_heads(self) -> None:
        """Another incarnation has begun, here or there."""
        self._peers.clear()
        self._heads.clear()


class Link:
    """Streams to and from other processes.

    Args:
        name: Name of this process.
        epoch: As :func:`~im_pnt_node.distributed.packets.new_epoch` makes one, unless a journal gives back the one it
            had.
        accept: Takes a message from a process; returns why it is refused, empty if it is not.
        returned: Takes back a message that its receiver refused, with the reason.
        reset: Is told that a process and this one do not remember the same: its name, why, and the messages to it that
            were in flight.
        heard: Is told of each process that gives a heartbeat.
        transmit: Sends a packet to a process; it may get lost.
        observer: Is told of packets that make no sense, and of streams that wait in vain.
        clock: Present time [s].

    Attributes:
        accept: As given; it may be set until something is heard.
        peers: The other processes, by name.
        record: Takes an entry for the journal, which is written before anything leaves; None: no journal is kept.
        held: Whether something is still to be written to the journal; nothing leaves then.
        fell_back: Is told the new epoch when it was found out that the journal of this process has forgotten something.
    """

    def __init__(
        self,
        name: str,
        epoch: int,
        accept: Callable[[str, Message], str],
        returned: Callable[[Message, str], None],
        reset: Callable[[str, str, list[Message]], None],
        heard: Callable[[str], None],
        transmit: Callable[[str, str], None],
        observer: Observer | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.name, self.epoch = name, epoch
        self.accept, self._returned, self._reset, self._heard = accept, returned, reset, heard
        self.record: Callable[[LinkEntry], None] | None = None
        self.held: Callable[[], bool] = lambda: False
        self.fell_back: Callable[[int], None] = lambda epoch: None
        self.peers: dict[str, Peer] = {}
        self._quoted = json.dumps(name)
        self._transmit = transmit
        self._observer, self._clock = observer or Observer(), clock
        self._stirred: dict[str, Peer] = {}
        self._express = Express()
        self._answers: dict[str, tuple[int, int]] = {}
        self._came_back = False
        self._unproved = self._senseless = 0
        self._overtake_at = self._report_at = self._drop_at = 0.0

    # Sending, and retransmission.

    def send(self, node: str, message: Message) -> None:
        """Number a message; the message leaves with the next :meth:`flush`, and arrives once.

        Raises:
            NetError: JSON cannot carry a part of it.
        """
        peer = self.peers.get(node)
        if peer is None:
            peer = self._new_peer(node)
        outgoing = peer.outgoing
        number = outgoing.last + 1
        try:
            text = numbered(number, message)
        except NetError as error:
            raise NetError(f"{message} is not JSON data: {error}", net=message.net) from error
        self._happens(peer, MessageSent(node, number, text))
        if outgoing.last <= outgoing.floor + WINDOW and outgoing.question is None:
            peer.fresh.append(outgoing.waiting[number])
            self._stirred[node] = peer
        elif len(outgoing.waiting) % MANY_IN_FLIGHT == 0:
            self._observer.troubled("", f"{len(outgoing.waiting)} messages wait for {node}")

    def forget(self, request_id: str) -> None:
        """Send nothing more about a request."""
        for peer in self.peers.values():
            self._void(peer, [n for n, message in peer.in_flight() if message.request_id == request_id])

    def hold_all(self, held: bool) -> None:
        """Make unacknowledged messages say whether the jobs are paused or released; before anything leaves."""
        for peer in self.peers.values():
            for number, message in peer.in_flight():
                peer.outgoing.waiting[number].text = numbered(number, with_hold(message, held))

    def flush(self) -> None:
        """Send new messages, and due acknowledgements."""
        if not (self._stirred or self._answers) or self.held():
            return
        now = self._clock()
        if self._answers:
            self._send_answers()
        stirred, self._stirred = self._stirred, {}
        for node, peer in stirred.items():
            texts: list[str] = []
            if peer.fresh:
                for sent in peer.fresh:
                    sent.due = now + sent.interval
                    texts.append(sent.text)
                peer.fresh.clear()
            if texts or peer.incoming.owes(now):
                self._send_packets(node, peer, texts, now)

    def tick(self) -> None:
        """Send unacknowledged messages again, and acknowledge; call every 0.05 s or so."""
        if self.held():
            return
        self.flush()
        now = self._clock()
        for node, peer in self.peers.items():
            awaits = bool(peer.outgoing.waiting or peer.outgoing.question)
            texts = peer.outgoing.due(now) if awaits else []
            self._watch(peer, awaits, now)
            if texts or peer.incoming.owes(now):
                self._send_packets(node, peer, texts, now)

    def _watch(self, peer: Peer, awaits: bool, now: float) -> None:
        """Tell of a process out of reach of messages, and of messages reaching the process again."""
        if not awaits:
            peer.answered_at = None
        elif peer.answered_at is None:
            peer.answered_at = now
        silent_s = 0.0 if peer.answered_at is None else now - peer.answered_at
        if peer.unreached != (silent_s >= UNREACHED_S):
            peer.unreached = not peer.unreached
            waiting = len(peer.outgoing.waiting)
            text = f"{peer.name} has acknowledged nothing to {self.name} for {silent_s:.0f} s; {waiting} messages wait"
            self._observer.unreached(peer.name, text if peer.unreached else "")

    def _send_packets(self, node: str, peer: Peer, texts: list[str], now: float) -> None:
        incoming = peer.incoming
        ack = incoming.acknowledgement() if incoming.ack_at is not None and incoming.owes(now) else "0"
        head = f"{self._head(peer.quoted, incoming.epoch)},{peer.outgoing.floor + 1},{ack}"
        if len(texts) == 1:
            self._transmit(node, f"{head},{texts[0]}]")
            return
        for first in range(0, len(texts) or 1, MOST_PACKET_MESSAGES):
            self._transmit(node, ",".join((head, *texts[first : first + MOST_PACKET_MESSAGES])) + "]")

    def _send_answers(self) -> None:
        """Tell processes with a wrong or no epoch of the own process the incarnation, and acknowledge."""
        answers, self._answers = self._answers, {}
        for node, (heard, later) in answers.items():
            base = self.peers[node].outgoing.floor + 1 if node in self.peers else 1
            self._transmit(node, f"{self._head(json.dumps(node), heard)},{base},0]")
            if later:
                self._transmit(node, f"{self._head(json.dumps(node), later)},{base},{REMEMBERED}]")

    def _head(self, quoted: str, known: int) -> str:
        """Return the beginning of a packet: the incarnations of sender and receiver."""
        return f"[{self._quoted},{self.epoch},{0 if self.record is None else 1},{quoted},{known}"

    def _void(self, peer: Peer, numbers: list[int]) -> None:
        for number in numbers:
            self._happens(peer, MessageVoided(peer.name, number))

    def in_flight(self) -> dict[str, list[Message]]:
        """Return the unacknowledged messages, by process."""
        flights = {node: [message for _, message in peer.in_flight()] for node, peer in self.peers.items()}
        return {node: messages for node, messages in flights.items() if messages}

    def keeps_journal(self, node: str) -> bool:
        """Return whether a process has announced a journal."""
        return node in self.peers and self.peers[node].keeps_journal

    def idle(self) -> bool:
        """Whether everything is acknowledged, here and there."""
        return not self._answers and not any(
            peer.outgoing.waiting or peer.outgoing.question or peer.incoming.ack_at is not None or peer.unreached
            for peer in self.peers.values()
        )

    # Receiving. Acknowledgements leave with a later `flush` or `tick`, after the journal has been written.

    def hear(self, text: str) -> None:
        """Take in a packet; harmless unless the sender knows the present incarnation of the receiving process."""
        found = self._express.read(text)
        if found is None:
            self._hear_any(text)
            return
        peer, message = found
        sender = peer.name
        self._stirred[sender] = peer
        self._heard(sender)
        number = peer.incoming.floor + 1
        self._happens(peer, MessageTaken(sender, number, self.accept(sender, message)))

    def _hear_any(self, text: str) -> None:
        packet = read_packet(text, self.name)
        if isinstance(packet, str):
            if packet:
                self._drop(packet)
            return
        sender, epoch = packet.sender, packet.epoch
        peer = self.peers.get(sender)
        remembered = 0 if peer is None else peer.incoming.epoch
        if packet.known != self.epoch:
            if packet.ack == REMEMBERED and epoch == remembered and packet.known > self.epoch:
                self._overtake(sender, packet.known)
            self._doubt(packet)
            self._answer(sender, epoch)
        elif epoch < remembered:  # a packet that was late; or its clock has gone back: let it believe, and then know
            self._answer(sender, epoch, later=remembered)
        elif sender == self.name:
            self._drop(f"it says that it comes from {sender}, which is here")
        elif peer is None and len(self.peers) >= MOST_PEERS:
            text = f"a packet of {sender} was dropped: {MOST_PEERS} processes are known already"
            self._observer.troubled("", text)
        else:
            self._believe(peer or self._new_peer(sender), packet)

    def _believe(self, peer: Peer, packet: Packet) -> None:
        """Take in a packet of a process aware of the present incarnation of the receiving process."""
        sender, incoming, base = packet.sender, peer.incoming, packet.base
        self._stirred[sender] = peer
        parted, stranger = incoming.parted, not incoming.epoch
        begins = packet.epoch > incoming.epoch
        if begins:
            self._begin(sender, peer, packet.epoch, packet.journal)
        self._heard(sender)
        missed = base - 1 - incoming.floor
        jumps = missed > 0 and not parted and (not begins or (stranger and self._came_back))
        why = f"it lacks {missed} messages that {sender} has sent, and that were acknowledged to it"
        if jumps and not self._came_back:
            self._observer.troubled("", f"a packet of {sender} was dropped: {self.name} has not come back, and {why}")
            return
        epoch = self.epoch
        if packet.ack and packet.ack != REMEMBERED:
            self._acknowledged(sender, peer, packet.ack)
        if jumps and self._came_back:
            if peer.outgoing.question is not None:  # how far the other has taken is to be known before
                return
            self._fall_back(why, self.epoch)
        if self.epoch != epoch:  # the other sends again what it sent to the former incarnation
            return
        if missed > 0 or (parted and not begins):
            self._happens(peer, NumbersSkipped(sender, max(base - 1, incoming.floor)))
        incoming.told(base)
        self._take(sender, peer, packet.messages)
        self._express.keep_head(packet.head(self.name), peer)

    def _answer(self, node: str, heard: int, later: int = 0) -> None:
        """Tell a process the incarnation of the own process, with the next flush.

        Args:
            node: The process.
            heard: Epoch in which it seems to be: if it is, it believes the answer.
            later: Epoch in which it was known, if that is a later one.
        """
        if node in self.peers or len(self._answers) < MOST_STRANGERS:
            self._answers[node] = heard, later

    def _doubt(self, packet: Packet) -> None:
        """Report disbelieved packets, if many, or impossible."""
        self._unproved += 1
        ahead_s = began_at(packet.epoch) / 1e6 - wall()
        now = self._clock()
        if now < self._report_at or (self._unproved < MANY_UNPROVED and ahead_s <= MOST_AHEAD_S):
            return
        self._report_at = now + REPORT_EVERY_S
        later = f", and names an incarnation that begins {ahead_s:.3g} s from now" if ahead_s > MOST_AHEAD_S else ""
        self._observer.troubled(
            "",
            f"{self._unproved} packets were not taken: who sent them does not know the incarnation of {self.name}; "
            f"the last says that it comes from {packet.sender}{later}",
        )
        self._unproved = 0

    def _drop(self, why: str) -> None:
        """Report senseless packets: the first at once, then the number now and then."""
        self._senseless += 1
        now = self._clock()
        if now < self._drop_at:
            return
        self._drop_at = now + REPORT_EVERY_S
        what = "a packet was dropped" if self._senseless == 1 else f"{self._senseless} packets were dropped, the last"
        self._observer.troubled("", f"{what}: {why}")
        self._senseless = 0

    def _new_peer(self, node: str) -> Peer:
        peer = self.peers[node] = Peer(node)
        if self._came_back:  # it may have been known before, in what the journal lacks
            peer.outgoing.ask()
        return peer

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
            except NetError as error:
                refusal = error.message
            self._happens(peer, MessageTaken(sender, incoming.floor + 1, refusal))

    def _acknowledged(self, sender: str, peer: Peer, ack: object) -> None:
        outgoing = peer.outgoing
        sent = outgoing.last if outgoing.question is None else outgoing.asked_at
        match ack:
            case [int(floor), list(refused)] if 0 <= floor <= sent:
                outgoing.question, peer.answered_at = None, None
                for entry in refused:
                    match entry:
                        case [int(number), str(why)] if number in outgoing.waiting:
                            message = outgoing.waiting[number].message()
                            self._happens(peer, MessageRefused(sender, number))
                            self._returned(message, why)
                if floor > outgoing.floor:
                    self._happens(peer, MessagesAcknowledged(sender, floor))
            case [int(floor), list()] if floor > sent and self._came_back:
                if sent > outgoing.floor:
                    self._happens(peer, MessagesAcknowledged(sender, sent))
                self._fall_back(f"{sender} has taken {floor} messages, and it knows of {sent}", self.epoch)
            case _:
                text = f"{sender} acknowledged {str(ack)[:200]}, and {outgoing.last} messages were sent to it"
                self._observer.troubled("", text)

    # Lives.

    def come_back(self) -> None:
        """Mark the process as restored by the journal: the others know whether the journal is the newest."""
        self._came_back = True
        for peer in self.peers.values():
            peer.outgoing.ask()

    def _begin(self, node: str, peer: Peer, epoch: int, journal: bool) -> None:
        """Note another incarnation of a process: the first one heard, or one without the journal."""
        lost = peer.incoming.epoch != 0
        self._express.forget_heads()
        self._happens(peer, IncarnationBegun(node, epoch, journal))
        peer.outgoing.hurry()
        if lost:
            why = f"{node} came back without its journal"
            self._observer.forgot(f"{why}; what it and {self.name} have asked each other is given up")
            self._part(peer, why)

    def _part(self, peer: Peer, why: str) -> None:
        """Give up everything between two processes of different memory, except tokens under way."""
        in_flight = peer.in_flight()
        self._void(peer, [number for number, message in in_flight if not isinstance(message.event, TokenArrived)])
        self._reset(peer.name, why, [message for _, message in in_flight])

    def _fall_back(self, why: str, after: int) -> None:
        """Begin an incarnation later than another: the others remember more than the journal."""
        text = f"the journal of {self.name} was an old copy, or has lost its end: {why}"
        self._observer.forgot(f"{text}; what happened since is forgotten, and what was asked is given up")
        self._begin_incarnation(after)
        self._came_back = False
        self.fell_back(self.epoch)
        for peer in list(self.peers.values()):
            if peer.incoming.epoch:
                self._part(peer, text)

    def _overtake(self, sender: str, known: int) -> None:
        """Begin an incarnation later than one remembered by another process."""
        now = self._clock()
        if now < self._overtake_at or began_at(known) + 1 >= began_at(MOST_EPOCH):
            return
        self._overtake_at = now + OVERTAKE_EVERY_S
        why = f"{self.name} was known to {sender} in a later incarnation than this one"
        if self._came_back:
            self._fall_back(why, known)
        else:
            self._observer.troubled("", f"{why} (clock gone back, or a twin)")
            self._begin_incarnation(known)

    def _begin_incarnation(self, after: int) -> None:
        """Begin an incarnation later than another, and tell all processes."""
        self._express.forget_heads()
        raised = EpochRaised(new_epoch(after))
        if self.record is not None:
            self.record(raised)
        self.replay(raised)
        for node, peer in self.peers.items():
            peer.incoming.parted = self._came_back  # else nothing is forgotten here
            peer.outgoing.question = None
            peer.outgoing.hurry()
            self._answer(node, peer.incoming.epoch)

    # What happens to the streams, now and when a journal is replayed.

    def _happens(self, peer: Peer, entry: PeerEntry) -> None:
        if self.record is not None:
            self.record(entry)
        peer.apply(entry, self._clock)

    def replay(self, entry: LinkEntry) -> None:
        """Apply an entry again; messages owed to a process are due at once.

        Raises:
            NetError: It holds no message.
            ValueError: It does not fit the streams.
        """
        if isinstance(entry, MessageSent):
            Sent(entry.text).message()  # which is read again only when it is sent
        if isinstance(entry, EpochRaised):
            self.epoch = entry.epoch
            for peer in self.peers.values():
                peer.incoming.parted = True
        else:
            self.peers.setdefault(entry.node, Peer(entry.node)).apply(entry, lambda: 0.0)
