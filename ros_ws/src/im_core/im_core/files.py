"""Files from elsewhere are read within limits; files of ours are written whole or not at all."""

import contextlib
import errno
import os
import stat
from collections.abc import Sequence
from pathlib import Path

from im_core.errors import DataError, ImError, StoreError, printable
from im_core.ownership import check_owner, require_own

MEBIBYTE = 2**20
LARGEST = 64 * MEBIBYTE
"""Largest file where nobody says otherwise [bytes]."""


class FileError(DataError):
    """Unreadable file: missing, not regular, too large, not text, or of wrong content.

    Args:
        file: The file.
        sentence: What is wrong with it.
        line: Where, from 1; None: all of it.
        column: Where in the line, from 1.
    """

    def __init__(self, file: str | Path, sentence: str, line: int | None = None, column: int | None = None) -> None:
        shown = printable(str(file))
        where = ":".join([shown, *(str(each) for each in (line, column) if each is not None)])
        super().__init__(f"{where}: {sentence}", file=shown, line=line, column=column)
        self.sentence, self.line, self.column = sentence, line, column


def read_bytes(
    path: str | Path, largest: int = LARGEST, *, own: bool = False, within: Sequence[str | Path] = ()
) -> bytes:
    """Read a file of any kind safely: without waiting, and without reading more than the allowed size.

    Args:
        path: The file.
        largest: What it may have at most [bytes].
        own: Whether it must belong to this user and be no link, as where every user may make files.
        within: Folders that the opened file must lie in, however deep, whatever the path led to a moment ago; empty:
            the file may lie anywhere.

    Raises:
        FileError: There is none, it is no regular file (a folder, a FIFO, a device), it is larger, or it lies outside
            of the folders.
        LinkError: It must belong to this user, and does not.
    """
    try:
        # without O_NONBLOCK a FIFO would be waited for until somebody writes into it
        flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY
        descriptor = os.open(path, flags | (os.O_NOFOLLOW if own else 0))
        try:
            status = os.fstat(descriptor)
            if own:
                check_owner(Path(path), status)
            check_regular(path, status)
            _check_within(path, descriptor, within)
            with os.fdopen(descriptor, "rb", closefd=False) as file:
                data = file.read(largest + 1)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    except ValueError as error:  # a path that no file can have
        raise FileError(path, f"cannot be read: {error}") from error
    if len(data) > largest:
        raise FileError(path, f"is larger than {largest / MEBIBYTE:g} MiB, which is the limit")
    return data


def is_below(place: str | Path, folders: Sequence[str | Path]) -> bool:
    """Whether a path without links lies in one of some folders, however deep; links to the folders are followed."""
    return any(Path(place).is_relative_to(os.path.realpath(folder)) for folder in folders)


def _check_within(path: str | Path, descriptor: int, folders: Sequence[str | Path]) -> None:
    """Refuse an open file outside of some folders: a part of its path may have become a link since it was resolved.

    Raises:
        FileError: It lies outside.
    """
    if folders and not is_below(os.readlink(f"/proc/self/fd/{descriptor}"), folders):
        raise FileError(path, f"leads out of {', '.join(map(str, folders))} by a link, and is not read")


def check_regular(path: str | Path, status: os.stat_result) -> None:
    """Refuse anything but a regular file.

    Raises:
        FileError: It is something else.
    """
    if not stat.S_ISREG(status.st_mode):
        raise FileError(path, "cannot be read: it is not a regular file")


def read_text(path: str | Path, largest: int = LARGEST, *, within: Sequence[str | Path] = ()) -> str:
    """Read a text, without a byte order mark; arguments as of :func:`read_bytes`.

    Raises:
        FileError: As of :func:`read_bytes`, or it is not UTF-8; line and column are named.
    """
    data = read_bytes(path, largest, within=within)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        raise FileError(path, f"is not UTF-8 text: {error.reason}", line, column) from error


def write_whole(path: Path, content: str | bytes, *, own: bool = False) -> Path:
    """Write a file in one step: readers see the old or the new file; after the return, power loss keeps the new file.

    Args:
        path: The file; where it is a symbolic link, what it points to is replaced.
        content: Text, written as UTF-8, or bytes.
        own: Whether it lies where every user may make files: no other user may read it, and a link is replaced.

    Returns:
        `path`.

    Raises:
        StoreError: It cannot be written, or is a folder, a device or a pipe, and what was there before is untouched; or
            the disk failed when the new one had its name, and a loss of power decides which of them is there.
        LinkError: It must belong to this user, and does not.
    """
    data, beside = content.encode() if isinstance(content, str) else content, None
    try:
        target = path.resolve() if path.is_symlink() and path.exists() and not own else path
        if own:
            require_own(path)
        elif target.exists() and not target.is_file():
            reason = "no regular file"
            raise StoreError(f"{path} cannot be written: it is {reason}", file=str(path), reason=reason)
        # a name that nobody can foresee, and none that is taken: through a link of that name another file were written
        beside = target.with_name(f".{target.name[:100]}.{os.urandom(8).hex()}")
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(beside, flags, 0o600 if own else 0o666), "wb") as file:
            file.write(data)
            file.flush()
            if target.exists() and not own:
                os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
            os.fsync(file.fileno())
        os.replace(beside, target)
        synchronise_names(target.parent)
    except BaseException as error:
        if beside is not None:
            with contextlib.suppress(OSError):
                beside.unlink(missing_ok=True)
        if isinstance(error, OSError) and not isinstance(error, ImError):
            raise StoreError.of("written", path, error) from error
        raise
    return path


def make_mark(path: Path, content: str) -> None:
    """Make a marker file: the marker survives the death of the creating process.

    Nothing waits for the disk: :func:`synchronise_mark` does. On a full disk the file may lack its content.

    Args:
        path: The file; one that is there stays as it is.
        content: Text, written as UTF-8.

    Raises:
        StoreError: The file cannot be made.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    except FileExistsError:
        return
    except OSError as error:
        raise StoreError.of("made", path, error) from error
    with contextlib.suppress(OSError):
        os.write(descriptor, content.encode())
    os.close(descriptor)


def synchronise_mark(path: Path) -> None:
    """Return when a file of :func:`make_mark` outlives a loss of power.

    Raises:
        StoreError: The file is not there, or the disk has failed.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        synchronise_names(path.parent)
    except OSError as error:
        raise StoreError.of("synchronised", path, error) from error


def is_same(one: str | Path, other: str | Path) -> bool:
    """Return whether two paths lead to one existing file, by any names and links."""
    return os.path.exists(one) and os.path.exists(other) and os.path.samefile(one, other)


def make_folder(path: Path, mode: int = 0o777) -> Path:
    """Make a folder and missing parent folders; all survive a loss of power.

    Args:
        path: The folder.
        mode: Who may do what in it, if it is made; the umask takes from that.

    Returns:
        `path`.

    Raises:
        StoreError: It cannot be made, or is something else.
    """
    try:
        missing = [each for each in (path, *path.parents) if not each.exists()]
        path.mkdir(mode, parents=True, exist_ok=True)
        for each in missing:
            synchronise_names(each.parent)
    except OSError as error:
        raise StoreError.of("made", path, error) from error
    return path


def move(source: Path, target: Path) -> None:
    """Move a file or a folder durably: a loss of power does not undo the move.

    Raises:
        StoreError: It cannot be moved.
    """
    try:
        source.rename(target)
        for folder in dict.fromkeys((target.parent, source.parent)):
            synchronise_names(folder)
    except OSError as error:
        raise StoreError.of("moved", source, error) from error


def synchronise_names(folder: Path) -> None:
    """Wait until the disk has the names in a folder, if the file system supports synchronisation.

    Raises:
        OSError: The disk has failed.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)
