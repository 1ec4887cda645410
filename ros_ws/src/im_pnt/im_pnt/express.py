"""The express lane of a link: the next token from a process that was heard before is known by its spelling.

Nearly every packet between running nets is ``[sender, epoch, journal, receiver, known, base, 0, [number, 0, net,
place]]``, and only the number differs from the packet before. What comes before and after it is kept here as text when
it was read in full, so that it need not be read as JSON again. Every packet that is not spelled so goes the long way.
"""

from im_pnt.remote import Kind, Message, encode_message
from im_pnt.streams import Peer

MOST_TOKENS = 4096
_NO_ACKNOWLEDGEMENT = ",0,["


class Express:
    """Spellings that were read in full, and what they mean."""

    def __init__(self) -> None:
        self._peers: dict[str, Peer] = {}
        self._heads: dict[str, str] = {}
        self._tokens: dict[str, Message] = {}

    def read(self, text: str) -> tuple[Peer, Message] | None:
        """Reads a packet; returns its sender and the next token of its stream, None if it is any other packet."""
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
        """Keeps how a packet of a process began, up to ``base``, in the present lives of both."""
        self._peers.pop(self._heads.get(peer.name, ""), None)
        self._heads[peer.name] = head
        self._peers[head] = peer

    def keep_token(self, message: Message) -> None:
        """Keeps how a token is spelled that was not refused."""
        if message.kind is Kind.TOKEN and len(self._tokens) < MOST_TOKENS:
            self._tokens[f"{encode_message(message)}]]"] = message

    def forget_heads(self) -> None:
        """Another life has begun, here or there."""
        self._peers.clear()
        self._heads.clear()
