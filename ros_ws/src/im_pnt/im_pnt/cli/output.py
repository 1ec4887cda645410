"""Files that the commands of ``pnt`` write: whole or not at all."""

from pathlib import Path

from im_core.errors import ImError
from im_core.files import write_whole


def write_output(path: Path, text: str, *, overwrite: bool) -> None:
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
    try:
        write_whole(path, text)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ImError(f"cannot write '{path}': {reason}", code="input") from error
