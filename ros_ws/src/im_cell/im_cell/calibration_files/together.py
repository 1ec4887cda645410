"""Camera files changed together: a reader of the folder gets all old files or all new files.

While they are changed, and when that came to no end, the old ones are in the folder ``.before``.
"""

import contextlib
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from im_cell.calibration_files.laser import LASER
from im_core import clock
from im_core.errors import ConfigError
from im_core.files import make_folder, move, read_bytes, write_whole

_BEFORE, _ASIDE = ".before", ".aside"
#: How often a folder is read that is changed meanwhile, and how long to wait before it is read again [s].
_READINGS, _PAUSE_S = 50, 0.02

FoundT = TypeVar("FoundT")


def camera_files(folder: Path) -> list[Path]:
    """Return the camera files in force in a folder, sorted.

    Raises:
        OSError: It cannot be read.
    """
    before = folder / _BEFORE
    return _files(before if before.is_dir() else folder)


def read_between_changes(folder: Path, read: Callable[[], FoundT]) -> FoundT:
    """Read a folder with no file changed meanwhile; read again after a change.

    Raises:
        ConfigError: As ``read`` raises; or it changes again and again.
        OSError: It cannot be read.
    """
    for _ in range(_READINGS):
        before = _state(folder)
        try:
            found = read()
        except ConfigError:
            if _state(folder) == before:
                raise
        else:
            if _state(folder) == before:
                return found
        clock.sleep(_PAUSE_S)
    raise ConfigError(f"{folder}: cannot be read: its files were changed each of {_READINGS} times", file=str(folder))


def change_camera_files(folder: Path, contents: Mapping[str, str | None]) -> None:
    """Write files of cameras, all or none.

    Args:
        folder: Their folder; made if missing.
        contents: By name; None: the file is removed.

    Raises:
        OSError: They cannot be written; those in force are as before.
    """
    make_folder(folder)
    _restore(folder)
    try:
        _keep(folder)
        for name, text in contents.items():
            if text is None:
                (folder / name).unlink(missing_ok=True)
            else:
                write_whole(folder / name, text)
        _forget(folder)
    except OSError:
        with contextlib.suppress(OSError):
            _restore(folder)
        raise


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.yaml") if not path.name.startswith(".") and path.name != LASER)


def _state(folder: Path) -> dict[str, tuple[int, int] | None]:
    """Return a state of the files, different after any change: each change writes a new file."""
    state: dict[str, tuple[int, int] | None] = {}
    for path in (folder / _BEFORE, *folder.glob("*.yaml")):
        try:
            told = path.stat()
        except FileNotFoundError:
            state[path.name] = None
        else:
            state[path.name] = told.st_ino, told.st_mtime_ns
    return state


def _keep(folder: Path) -> None:
    """Copy the files to a backup, kept until all files are changed."""
    aside = folder / _ASIDE
    shutil.rmtree(aside, ignore_errors=True)
    make_folder(aside)
    for path in _files(folder):
        write_whole(aside / path.name, read_bytes(path))
    move(aside, folder / _BEFORE)


def _forget(folder: Path) -> None:
    """Remove the backup; from the first step on, the files of the folder are in force."""
    aside = folder / _ASIDE
    shutil.rmtree(aside, ignore_errors=True)
    move(folder / _BEFORE, aside)
    shutil.rmtree(aside, ignore_errors=True)


def _restore(folder: Path) -> None:
    """Restore the files left by an unfinished change."""
    before = folder / _BEFORE
    if not before.is_dir():
        return
    for path in _files(before):
        write_whole(folder / path.name, read_bytes(path))
    for path in _files(folder):
        if not (before / path.name).exists():
            path.unlink()
    _forget(folder)
