"""Files that the commands of ``pnt`` write: whole or not at all."""

import os
import tempfile
from pathlib import Path

from im_core.errors import ImError


def write_whole(path: Path, text: str, *, overwrite: bool) -> None:
    """Writes a text file in one step: whoever reads it sees the old one or the new one.

    Args:
        path: The file.
        text: What to write.
        overwrite: Whether it may be there already.

    Raises:
        ImError: It is there already, or cannot be written.
    """
    if not overwrite and (path.exists() or path.is_symlink()):
        raise ImError(f"'{path}' is there already; --force overwrites it", code="input")
    target = path.resolve() if path.is_symlink() and path.exists() else path
    try:
        descriptor, name = tempfile.mkstemp(prefix=f".{target.name[:100]}.", dir=target.parent)
        try:
            with os.fdopen(descriptor, "w", encoding="utf-8", newline="\n") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            os.replace(name, target)
        except BaseException:
            os.unlink(name)
            raise
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ImError(f"cannot write '{path}': {reason}", code="input") from error
