"""Paths of files and folders in messages: always below configured folders, for any sender."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from im_core.errors import DataError, quoted_text
from im_core.files import is_below, make_folder, read_bytes, write_whole
from im_core.names import results_dir, run_dir

#: Names more folders, separated by colons.
MORE_FOLDERS = "IM_FOLDERS"


def message_folders() -> list[Path]:
    """Return the allowed folders of paths in messages: results, files handed over by clients, ``IM_FOLDERS``.

    Raises:
        StoreError: One of the machine's own cannot be made.
        DataError: No message can carry its name.
    """
    more = os.environ.get(MORE_FOLDERS, "").split(os.pathsep)
    return [results_dir(), handed_over(), *(Path(each) for each in more if each)]


def resolve_below(path: str, folders: Sequence[Path], what: str) -> Path:
    """Resolve a path from a message, links followed.

    Args:
        path: The path; a relative one is of the first folder. Whether there is such a file is not told.
        folders: Folders that it may be in, however deep.
        what: Field of the message, for errors.

    Returns:
        The path without links: write this one, or read it ``within`` the folders (:func:`im_core.files.read_bytes`),
        since somebody may put a link into it meanwhile.

    Raises:
        DataError: It leads out of all folders.
    """
    shown = quoted_text(path)
    if "\0" in path:
        raise DataError(f"{what}: {shown} is no path", what=what)
    place = Path(os.path.realpath(folders[0] / path))
    if not is_below(place, folders):
        allowed = ", ".join(map(str, folders))
        raise DataError(f"{what}: {shown} is outside of {allowed}; {MORE_FOLDERS} of the machine names more", what=what)
    return place


def hand_over(path: Path) -> Path:
    """Copy a file of a client to a folder readable by the machine.

    Returns:
        The copy, for a message to the machine of this run folder; the same content has one copy.

    Raises:
        FileError: The file cannot be read.
        StoreError: The copy cannot be written.
    """
    content = read_bytes(path)
    folder = make_folder(handed_over() / hashlib.sha256(content).hexdigest()[:16])
    return write_whole(folder / path.name, content)


def handed_over() -> Path:
    """Return the folder of files handed over by clients of this run folder; made if missing.

    Raises:
        StoreError: It cannot be made.
        DataError: No message can carry its name.
    """
    return make_folder(run_dir() / "given")
