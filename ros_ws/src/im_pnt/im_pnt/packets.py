"""Packets between processes, as lines of JSON.

``[sender, epoch, journal, receiver, known, base, ack, message, ...]``: ``journal`` is 1 if the sender keeps one;
``known`` the receiver's epoch as the sender knows it (0: never heard); ``base`` the first number that was not
acknowledged to the sender; ``ack`` is 0 or ``[number, [[refused number, why], ...]]``: everything up to that number was
taken, but for what was refused. A message is its number and what :func:`im_pnt.remote.encode_message` writes. Nothing
is taken from a packet for another life of its receiver; it is answered, so that its sender learns.
"""

import json
from typing import NamedTuple

from im_pnt.remote import is_number

_HEAD = 7
MOST_NAME = 200
"""Characters of the name of a process."""


class Packet(NamedTuple):
    """A packet; what it acknowledges, and the messages, are still to be looked at."""

    sender: str
    epoch: int
    journal: bool
    known: int
    base: int
    ack: object
    messages: list[object]

    def head(self, receiver: str) -> str:
        """Returns how it begins, up to ``base``, as it is usually written."""
        return f'["{self.sender}",{self.epoch},{int(self.journal)},"{receiver}",{self.known},{self.base}'


def read_packet(text: str, receiver: str) -> Packet | str:
    """Reads a packet.

    Args:
        text: The line.
        receiver: Name of the process that reads.

    Returns:
        The packet; or why it is none, empty if it is for another process.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        return f"it is not JSON: {error}"
    if not isinstance(content, list) or len(content) < _HEAD:
        return f"it makes no sense: {text[:MOST_NAME]}"
    sender, epoch, journal, to, known, base, ack = content[:_HEAD]
    if to != receiver:
        return ""
    if not (isinstance(sender, str) and sender.isascii() and sender.isidentifier() and len(sender) <= MOST_NAME):
        return f"{str(sender)[:MOST_NAME]!r} is no name of a process"
    if not (is_number(epoch) and is_number(known) and is_number(base) and epoch and base):
        return f"its numbers make no sense: {text[:MOST_NAME]}"
    return Packet(sender, epoch, journal == 1, known, base, ack, content[_HEAD:])
