"""Names of nets, places, transitions and symbols."""

import re

from im_core.errors import shortened

MAX_NAME = 200
"""Longest name [characters]."""

NAME = "[A-Za-z_][A-Za-z0-9_]*"
QUALIFIED = rf"{NAME}(\.{NAME})*"
"""Name of a place or transition: that of a subnet's part begins with the name of its use and a dot."""

NAME_RULE = f"letters, digits and _, not starting with a digit, at most {MAX_NAME}"


def is_name(text: str) -> bool:
    """Whether a text is letters, digits and _, does not start with a digit, and is not too long."""
    return len(text) <= MAX_NAME and re.fullmatch(NAME, text) is not None


def is_qualified(text: str) -> bool:
    """Whether a text is a name, or several with dots between them, and is not too long."""
    return len(text) <= MAX_NAME and re.fullmatch(QUALIFIED, text) is not None


def as_name(text: str) -> str:
    """Make a name of any text, with _ for forbidden characters."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)[: MAX_NAME - 10] or "_"
    return f"_{name}" if name[0].isdigit() else name


def shown_name(name: str) -> str:
    """Return a name for messages, the beginning of a long one."""
    return shortened(name)
