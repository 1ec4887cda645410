"""Own parts of a PNML file: ``toolspecific`` with an element for each key of our net files, the value in JSON."""

import json
import re
from collections.abc import Mapping

from im_core.text.jsontext import decode_json
from im_core.text.yamltext import MAX_DEPTH, Kind, Value, mapping, scalar, sequence
from im_pnt.pnml.element import Element

TOOL = "im"
VERSION = "1"
NAMESPACE = "urn:im:pnt:net:1"

_ILLEGAL = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

REMOTE = "remote_place"
"""Key of a place that stands for one of another net: its ``net.place``."""


def read_extras(element: Element) -> dict[str, tuple[Element, Value]]:
    """Return the own parts of a net, place or transition, by key.

    Raises:
        NetFileError: Of a version that is not known, or not JSON.
    """
    found: dict[str, tuple[Element, Value]] = {}
    for tool in element.all("toolspecific"):
        if tool.attributes.get("tool") != TOOL:
            continue
        version = tool.attributes.get("version")
        if version != VERSION:
            raise tool.error(f"version '{version}' of {TOOL} is not known; {VERSION} is")
        for entry in tool.children:
            if entry.namespace != NAMESPACE:
                raise entry.error(f"is not in the namespace {NAMESPACE}")
            if entry.tag in found:
                raise entry.error("is there twice")
            found[entry.tag] = (entry, _value(entry))
    return found


def extras_text(data: Mapping[str, object], indent: str) -> str:
    """Return the ``toolspecific`` element of some keys; nothing where there are none."""
    if not data:
        return ""
    lines = [f'{indent}<toolspecific tool="{TOOL}" version="{VERSION}" xmlns:im="{NAMESPACE}">\n']
    lines += [f"{indent}  <im:{key}>{escape(json.dumps(value))}</im:{key}>\n" for key, value in data.items()]
    return "".join([*lines, f"{indent}</toolspecific>\n"])


def escape(text: str) -> str:
    """Return a text as the content of an XML element; characters without an XML form become U+FFFD."""
    text = _ILLEGAL.sub("\ufffd", text)
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("\r", "&#13;")


def plain_value(data: object, near: Value, depth: int = 0) -> Value:
    """Return plain data as the value of a file.

    Raises:
        ValueError: The data nest deeper than a file may.
    """
    if depth > MAX_DEPTH:
        raise ValueError(f"values nest deeper than {MAX_DEPTH}")
    if isinstance(data, dict):
        pairs = [(scalar(str(key), near), plain_value(child, near, depth + 1)) for key, child in data.items()]
        return mapping(pairs, near)
    if isinstance(data, list):
        return sequence([plain_value(child, near, depth + 1) for child in data], near)
    if isinstance(data, str):
        return scalar(data, near)
    return scalar(json.dumps(data), near, quoted=False)


def _value(entry: Element) -> Value:
    near = Value(Kind.SCALAR, entry.place.file, entry.place.line, entry.place.column)
    try:
        return plain_value(decode_json(entry.text), near)
    except ValueError as error:
        raise entry.error(f"cannot be read: {error}") from error
