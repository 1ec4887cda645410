"""Ownership of files where every user of the host may make some, as in ``/dev/shm``: no user's file is used by another.

Opening such a file must follow no link (``O_NOFOLLOW``), making one must fail where the name is taken (``O_EXCL``).
"""

import os
import pwd
import stat
import sys
from pathlib import Path

from im_core.errors import LinkError

_WRITABLE = stat.S_IWGRP | stat.S_IWOTH
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_SHARED = os.path.expanduser("~"), sys.prefix, sys.base_prefix


def require_own(path: Path) -> int | None:
    """Refuse a file of another user; a link is not followed.

    Args:
        path: The file, below ``/dev/shm``.

    Returns:
        Its inode, which names it for good; None if there is no such file.

    Raises:
        LinkError: As of :func:`check_owner`.
    """
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    check_owner(path, status)
    return status.st_ino


def check_owner(path: Path, status: os.stat_result, way_out: str = "set another ROS_DOMAIN_ID") -> None:
    """Refuse a file or folder of another user, or one writable by other users.

    Args:
        path: Its name, for the message.
        status: What the kernel says of it.
        way_out: What to do other than to remove it or to change its mode.

    Raises:
        LinkError: It is refused; the message names the owner or the mode.
    """
    if status.st_uid != os.geteuid():
        reason = f"belongs to {user(status.st_uid)}, not to you; remove it"
    elif status.st_mode & _WRITABLE and not stat.S_ISLNK(status.st_mode):  # the mode of a link means nothing
        reason = f"may be written by other users (mode {stat.S_IMODE(status.st_mode):o}); chmod go-w it"
    else:
        return
    raise LinkError(f"{path} {reason}, or {way_out}", name=path.name)


def make_private(folder: Path, way_out: str) -> str:
    """Take the rights of all other users from a folder of this user.

    Args:
        folder: The folder.
        way_out: What to do other than to remove the folder or to change its mode.

    Returns:
        A sentence that names the mode before; empty: no other user had a right, or the file system keeps the mode and
        other users may only read.

    Raises:
        LinkError: The folder belongs to another user, every user may write into it (files of theirs may be there), or
            the user's home, the program or the working folder lies in it: closing it would harm other programs.
        OSError: The folder cannot be looked at.
    """
    status = folder.stat()
    if status.st_uid != os.geteuid() or status.st_mode & stat.S_IWOTH:
        check_owner(folder, status, way_out)
    if not status.st_mode & _OTHERS:
        return ""
    if any(Path(place).resolve().is_relative_to(folder.resolve()) for place in (*_SHARED, ".")):
        raise LinkError(f"{folder} is no folder of the machine's own; {way_out}", name=folder.name)
    try:
        folder.chmod(stat.S_IMODE(status.st_mode) & ~_OTHERS)
    except OSError:
        check_owner(folder, status, way_out)
        return ""
    return f"{folder} was open to other users (mode {stat.S_IMODE(status.st_mode):o}), and is for this user alone now"


def is_own(path: Path) -> bool:
    """Return whether a file exists and belongs to the user; a link is not followed."""
    try:
        return path.lstat().st_uid == os.geteuid()
    except OSError:
        return False


def user(uid: int) -> str:
    """Format a user as number and, if known to the host, name."""
    try:
        return f"user {uid} ({pwd.getpwuid(uid).pw_name})"
    except KeyError:
        return f"user {uid}"
