"""Nets to YAML, as an author writes them: a line a place, a line a key of a transition."""

import json
import re
from collections.abc import Iterator, Mapping

from im_pnt.net import Net
from im_pnt.netfile.describe import describe

_BARE = re.compile(r"[A-Za-z_/][A-Za-z0-9_./]*( [A-Za-z0-9_./]+)*")
_UNPRINTABLE = re.compile("[^\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]")
_OTHERWISE = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})
"""Words that YAML 1.1 or 1.2 takes for something else than a text."""


def yaml_text(net: Net) -> str:
    """Returns a net as the text of a YAML file.

    Raises:
        NetError: An expanded net.
    """
    return "\n".join([*_lines(describe(net)), ""])


def _lines(data: Mapping[str, object]) -> Iterator[str]:
    for key, value in data.items():
        if key == "transitions" and isinstance(value, Mapping):
            yield from ("", "transitions:" if value else "transitions: {}")
            for name, transition in value.items():
                yield f"  {_flow(name)}:" if transition else f"  {_flow(name)}: {{}}"
                yield from (f"    {key}: {_flow(entry)}" for key, entry in transition.items())
        elif key in ("places", "services") and isinstance(value, Mapping):
            yield from ("", f"{key}:" if value else f"{key}: {{}}")
            yield from (_place(name, entry) for name, entry in value.items())
        else:
            yield f"{key}: {_flow(value)}"


def _place(name: str, data: Mapping[str, object]) -> str:
    if not data:
        return f"  {_flow(name)}:"
    return f"  {_flow(name)}: {_flow(data['tokens'] if data.keys() == {'tokens'} else data)}"


def _flow(value: object) -> str:
    """Writes a value in one line; texts that could be taken for something else in quotes."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_flow(key)}: {_flow(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str):
        bare = _BARE.fullmatch(value) and value.lower() not in _OTHERWISE
        return value if bare else _UNPRINTABLE.sub(_escaped, json.dumps(value, ensure_ascii=False))
    return json.dumps(value)


def _escaped(match: re.Match[str]) -> str:
    return f"\\U{ord(match.group()):08x}"
