"""Values made from the type of a message: extremes, no numbers, wrong lengths, large; and bytes that are no message."""

import math
import random
import re
from typing import Any

from rclpy.serialization import serialize_message

from im_core.ros.messages.interfaces import interface_class

#: No value is one that a joint, a pose, a time or a gripper could be sent to.
FLOATS = (math.nan, math.inf, -math.inf, -1e300, 1e300, 5e-324, -7.0)
TEXTS: tuple[str, ...] = ("", "\x01", "x" * 300, "../..", "/dev/zero", "77", "ä\U0001f916")
TEXTS += ("[]", "{}", "null", '"\\ud800"', "[" * 5000, "{a: " * 300)  # for those who read JSON or YAML
COUNTS = (0, 1, 2, 7, 100)
LARGE = 2_000_000
_RANGE = {"octet": (0, 255), "char": (0, 255)} | {
    f"{sign}int{bits}": (0, 2**bits - 1) if sign else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    for sign in ("u", "")
    for bits in (8, 16, 32, 64)
}


class Values:
    """Makes values.

    Args:
        seed: Of what is drawn.
        large: Share of the texts and lists of bytes that have :data:`LARGE` elements.
    """

    def __init__(self, seed: int, large: float) -> None:
        self._rng = random.Random(seed)
        self._large = large

    def message(self, kind: type[Any]) -> Any:
        """A message of a type, every field of it drawn."""
        message = kind()
        for name, field in message.get_fields_and_field_types().items():
            setattr(message, name, self._field(field))
        return message

    def broken(self, message: Any) -> bytes:
        """The bytes of a message, cut, or with lengths that cannot be; by accident they may be a message still."""
        data = bytearray(serialize_message(message))
        if self._rng.random() < 0.5 or len(data) <= 8:
            return bytes(data[: self._rng.randrange(len(data) + 1)])
        at = self._rng.randrange(4, len(data) - 3)
        data[at : at + 4] = self._rng.choice((b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\xed\xa0\x80\x00"))
        return bytes(data)

    def _field(self, kind: str) -> Any:
        sequence = re.fullmatch(r"sequence<(.+?)(?:, (\d+))?>|(.+)\[(\d+)\]", kind)
        if sequence is None:
            return self._value(kind)
        element, most = sequence[1] or sequence[3], int(sequence[2] or sequence[4] or 10**9)
        if element in ("uint8", "octet") and not sequence[4] and self._rng.random() < self._large:
            return bytes(min(LARGE, most))
        count = most if sequence[4] else min(self._rng.choice(COUNTS if "/" not in element else COUNTS[:4]), most)
        items = [self._value(element) for _ in range(count)]
        return bytes(items) if element == "octet" and not items else items

    def _value(self, kind: str) -> Any:
        if kind in ("double", "float"):
            value = self._rng.choice(FLOATS)
            return max(-3e38, min(3e38, value)) if kind == "float" and math.isfinite(value) else value
        if kind.startswith(("string", "wstring")):
            text = "x" * LARGE if self._rng.random() < self._large else self._rng.choice(TEXTS)
            bound = re.search(r"<(\d+)>", kind)
            return text[: int(bound[1])] if bound else text
        if kind == "boolean":
            return self._rng.random() < 0.5
        if kind in _RANGE:
            low, high = _RANGE[kind]
            value = self._rng.choice((low, high, 0, 77))
            return bytes([value]) if kind == "octet" else value
        return self.message(interface_class(kind.replace("/", "/msg/")))
