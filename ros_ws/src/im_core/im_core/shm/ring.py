"""Messages of JSON and bytes from one process to another, in order."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, LinkError

_LENGTH_BYTES = 4
# stands for bytes in a message's text, with their number; no message has such a name of its own
_BYTES = "\0bytes"
_BYTES_TEXT = json.dumps(_BYTES).encode()


class MessageRing:
    """Queue with one writer and one reader, never blocking each other.

    Two counters run through the ring: ``head`` (bytes written, moved by the writer) and ``tail`` (bytes read, moved by
    the reader). A message is its length and that of its JSON text (4 bytes each), the text, and the values of type
    ``bytes`` that the message has anywhere, in order: to read a megabyte as JSON would take some milliseconds.
    """

    def __init__(self, memory: NDArray[Any], name: str) -> None:
        """Use the memory of a ring.

        Args:
            memory: Fields of :meth:`layout`, shape (), all zeros at first.
            name: Name for errors.
        """
        self.name = name
        self._counters = memory["counters"]
        self._data = memory["data"].data
        self.capacity = len(self._data)

    @staticmethod
    def layout(capacity: int = 65536) -> np.dtype[np.void]:
        """Return the fields of a ring of ``capacity`` bytes."""
        return np.dtype([("counters", "<u8", (2,)), ("data", "u1", (capacity,))], align=True)

    def send(self, message: dict[str, Any]) -> None:
        """Append a message.

        Raises:
            DataError: The message is neither JSON (NaN and infinity are not) nor bytes.
            LinkError: The reader has not made room.
        """
        parts: list[bytes] = []

        def put_aside(value: object) -> dict[str, int]:
            if not isinstance(value, bytes):
                raise TypeError(f"{type(value).__name__} is neither JSON nor bytes")
            parts.append(value)
            return {_BYTES: len(value)}

        try:
            text = json.dumps(message, allow_nan=False, separators=(",", ":"), default=put_aside).encode()
        except (TypeError, ValueError) as error:
            raise DataError(f"a message for ring '{self.name}' is not JSON: {error}") from None
        data = b"".join([len(text).to_bytes(_LENGTH_BYTES, "little"), text, *parts])
        head, tail = int(self._counters[0]), int(self._counters[1])
        needed, free = _LENGTH_BYTES + len(data), self.capacity - (head - tail)
        if needed > free:
            raise LinkError(
                f"ring '{self.name}' is full: a message of {needed} bytes, {free} of {self.capacity} free",
                name=self.name,
                needed=needed,
                free=free,
            )
        self._put(head, len(data).to_bytes(_LENGTH_BYTES, "little"))
        self._put(head + _LENGTH_BYTES, data)
        self._counters[0] = head + needed

    def receive(self) -> dict[str, Any] | None:
        """Take the oldest message, None if there is none."""
        head, tail = int(self._counters[0]), int(self._counters[1])
        if head == tail:
            return None
        length = int.from_bytes(self._take(tail, _LENGTH_BYTES), "little")
        message = _decoded(self._take(tail + _LENGTH_BYTES, length))
        self._counters[1] = tail + _LENGTH_BYTES + length
        return message

    def receive_all(self) -> Iterator[dict[str, Any]]:
        """Take messages, oldest first, until there is none."""
        while (message := self.receive()) is not None:
            yield message

    @property
    def filled(self) -> float:
        """Share of the ring not yet taken by the reader, 0 to 1."""
        return (int(self._counters[0]) - int(self._counters[1])) / self.capacity

    def empty(self) -> bool:
        """Whether every message has been taken."""
        return int(self._counters[0]) == int(self._counters[1])

    def _put(self, position: int, data: bytes) -> None:
        start = position % self.capacity
        first = min(len(data), self.capacity - start)
        self._data[start : start + first] = data[:first]
        self._data[: len(data) - first] = data[first:]

    def _take(self, position: int, count: int) -> bytes:
        start = position % self.capacity
        first = min(count, self.capacity - start)
        return bytes(self._data[start : start + first]) + bytes(self._data[: count - first])


def _decoded(data: bytes) -> dict[str, Any]:
    """The message of the length of its text, the text, and bytes."""
    at = _LENGTH_BYTES + int.from_bytes(data[:_LENGTH_BYTES], "little")

    def put_back(value: dict[str, Any]) -> object:
        nonlocal at
        if _BYTES not in value:
            return value
        at += value[_BYTES]
        return data[at - value[_BYTES] : at]

    text = data[_LENGTH_BYTES:at]
    message: dict[str, Any] = json.loads(text, object_hook=put_back if _BYTES_TEXT in text else None)
    return message
