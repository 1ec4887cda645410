"""The mission of a run folder: journals of the nets, data objects, and which commands have not ended.

They belong together: where the nets begin anew, what the objects of the former nets stood for is not so any more.
"""

import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from im_core import names, unfinished_commands
from im_core.clock import stamp_name
from im_core.files import make_folder, move, read_text, write_whole

_ALIVE = "alive"
"""Is there from when a machine was ready until it was stopped."""
_STORE = ("dom.sqlite", "dom.sqlite-wal", "dom.sqlite-shm", "dom.sqlite-list")
PARTS = ("journal", "commands", *_STORE, names.CALIBRATION, _ALIVE)
KEPT = 5
"""Missions that were not gone on with, the newest ones."""
#: Folder of a mission that is being set aside; only then it gets its name.
_MOVING = "unfinished"
_NUMBERED = re.compile(r"\d{8}-\d{6}-\d{1,9}")


def prepare(run_dir: Path, fresh: bool, say: Callable[[str], None]) -> bool:
    """Have the machine take up the mission before, or begin a new one.

    It is taken up if commands of it had not ended, or if its machine was not stopped but died: what others had it keep,
    loaded nets and data objects, is there again.

    What a mission has left that is not gone on with is kept beside; of such the newest few are.

    Args:
        run_dir: Folder of the machine's logs and data bases.
        fresh: Begin a new one in any case.
        say: Takes a sentence about what had not ended, and about what is not there any more.

    Returns:
        Whether it is taken up.

    Raises:
        StoreError: Something cannot be moved.
    """
    moving = run_dir / unfinished_commands.MISSIONS / _MOVING
    if any((moving / part).exists() and (run_dir / part).exists() for part in PARTS):
        _give_name(moving)  # it was whole when the mission that is here began
    unfinished = unfinished_commands.noted(run_dir) or unfinished_commands.noted(moving)
    died = (run_dir / _ALIVE).exists()
    known = ", ".join(map(str, unfinished))
    if (unfinished or died) and not fresh and (run_dir / "journal").is_dir() and not moving.exists():
        if unfinished:
            say(f"commands had not ended when the machine was: {known}; start.sh --fresh sets them aside")
        else:
            say(
                "the machine before was not stopped but died: its loaded nets and data objects are there again; "
                "start.sh --fresh sets them aside"
            )
        return True
    aside = _set_aside(run_dir)
    if aside is not None and unfinished:
        say(f"commands had not ended when the machine was: {known}; what they have left is kept in {aside}")
    elif aside is not None:
        say(f"a new mission begins; data objects and loaded nets of the one before are kept in {aside}")
    return False


def begin(run_dir: Path, run: str) -> None:
    """Record the machine of a run folder as ready: from now on an end without a call of :func:`end` is a death.

    Args:
        run_dir: As of :func:`prepare`.
        run: Name of the run of the machine.

    Raises:
        StoreError: It cannot be written down.
    """
    write_whole(run_dir / _ALIVE, run)


def run_of(run_dir: Path) -> str | None:
    """Return the name of the last run of a run folder; None: none has begun, or the last one was stopped.

    Raises:
        FileError: It cannot be read.
    """
    path = run_dir / _ALIVE
    return read_text(path) if path.exists() else None


def end(run_dir: Path) -> None:
    """Record the machine of a run folder as stopped: if all commands have ended, the next machine begins anew."""
    with suppress(OSError):  # then it goes on, and says so
        (run_dir / _ALIVE).unlink()


def _set_aside(run_dir: Path) -> Path | None:
    """Move the files of a mission aside as a whole, also the rest of a mission from an interrupted move."""
    found = [run_dir / part for part in PARTS if (run_dir / part).exists()]
    moving = run_dir / unfinished_commands.MISSIONS / _MOVING
    if not found and not moving.exists():
        return None
    make_folder(moving)
    for part in found:
        move(part, moving / part.name)
    return _give_name(moving)


def _give_name(moving: Path) -> Path:
    """Name a moved mission; of the named missions keep the newest."""
    before = sorted((path for path in moving.parent.iterdir() if _NUMBERED.fullmatch(path.name)), key=_number)
    aside = moving.with_name(f"{stamp_name()}-{_number(before[-1]) + 1 if before else 1}")
    move(moving, aside)
    for old in [*before, aside][:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return aside


def _number(folder: Path) -> int:
    return int(folder.name.rpartition("-")[2])
