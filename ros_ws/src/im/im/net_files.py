"""Net files for the Dispatcher, with the files that they include: the Dispatcher may be on another host."""

import os
from pathlib import Path

from im_core import files
from im_core.text.yamltext import YamlError, find, read_yaml

MAX_FILES = 100
"""Most included files that are sent; a net file may include as many."""


def read_net_file(path: str | Path) -> tuple[str, dict[str, str]]:
    """Read a net file, and the files that it and these include.

    Returns:
        The text, and the texts of the included files by the path from the folder of the net file. A missing file is
        left out: the Dispatcher may have it, or names it.

    Raises:
        FileError: A file cannot be read, or is not UTF-8.
    """
    file = Path(path)
    text, included = files.read_text(file), dict[str, str]()
    pending = [("", text)]
    while pending:
        folder, content = pending.pop()
        for name in _included(content):
            place = os.path.normpath(os.path.join(folder, name))
            if place in included or len(included) == MAX_FILES or not (file.parent / place).is_file():
                continue
            included[place] = files.read_text(file.parent / place)
            pending.append((os.path.dirname(place), included[place]))
    return text, included


def _included(text: str) -> list[str]:
    """Return the paths that a text includes; none of a text that is no YAML, which the Dispatcher refuses."""
    try:
        root = read_yaml(text, "net")
    except YamlError:
        return []
    value = find(root, ("include",)).value
    return [each.text for each in value.children or (value,)] if value is not root else []
