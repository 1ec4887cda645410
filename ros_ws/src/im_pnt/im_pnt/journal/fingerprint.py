"""Fingerprints of nets: whether a journal belongs to the net that is to be brought back."""

import dataclasses
import enum
import functools
import hashlib
import json
from collections.abc import Mapping

from im_pnt.net import Net

_UNIMPORTANT = ("line", "source", "description")


def fingerprint(net: Net) -> str:
    """Returns 16 hexadecimal digits that differ for nets that behave differently.

    Args:
        net: The net, as written; where it was written, and its description, do not count.
    """
    text = json.dumps(_plain(net), separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _plain(value: object) -> object:
    if isinstance(value, (str, int, float, type(None))):
        return value.name if isinstance(value, enum.Enum) else value
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, Mapping):
        return [[_plain(key), _plain(entry)] for key, entry in value.items()]
    kind: type = type(value)
    names = _fields(kind)
    if names:
        return [kind.__name__, {name: _plain(getattr(value, name)) for name in names}]
    return repr(value)


@functools.cache
def _fields(kind: type) -> tuple[str, ...]:
    if not dataclasses.is_dataclass(kind):
        return ()
    return tuple(field.name for field in dataclasses.fields(kind) if field.name not in _UNIMPORTANT)
