"""Names in net files."""

import re
from collections.abc import Collection

from im_pnt.errors import nearest
from im_pnt.netfile.node import Node

MAX_LENGTH = 200
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_RULE = f"letters, digits and _, not starting with a digit, at most {MAX_LENGTH}"


def is_name(text: str) -> bool:
    """Whether a text is letters, digits and _, does not start with a digit, and is not too long."""
    return len(text) <= MAX_LENGTH and _NAME.fullmatch(text) is not None


def as_name(text: str) -> str:
    """Makes a name of any text, with _ for what a name cannot have."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)[: MAX_LENGTH - 10] or "_"
    return f"_{name}" if name[0].isdigit() else name


def checked(node: Node) -> str:
    """Returns a text that is a name.

    Raises:
        NetFileError: It is not.
    """
    text = node.text()
    if not is_name(text):
        raise node.error(f"{node.shown()} is not a name ({_RULE})")
    return text


def checked_key(node: Node, name: str) -> str:
    """Returns the key of a node, which must be a name.

    Raises:
        NetFileError: It is not.
    """
    if not is_name(name):
        shown = name if len(name) <= MAX_LENGTH else name[:60] + "..."
        raise node.key_error(f"'{shown}' is not a name ({_RULE})")
    return name


def known_place(node: Node, places: Collection[str]) -> str:
    """Returns a text that names a place.

    Raises:
        NetFileError: It does not.
    """
    name = node.text()
    if name not in places:
        raise node.error(no_place(name, places))
    return name


def no_place(name: str, places: Collection[str]) -> str:
    """Says that there is no such place."""
    shown = name if len(name) <= MAX_LENGTH else name[:60] + "..."
    return f"there is no place '{shown}'{nearest(name, places)}"



