"""The file of the data objects: opened so that nothing acknowledged is lost, and set aside where it is damaged."""

import sqlite3
from contextlib import closing
from pathlib import Path

from im_core.clock import stamp_name
from im_core.errors import DataError
from im_core.files import make_folder, move

SCHEMA_VERSION = 4

SCHEMA = f"""
BEGIN;
CREATE TABLE versions (
    name TEXT NOT NULL, version INTEGER NOT NULL, type TEXT NOT NULL, hash TEXT NOT NULL, valid INTEGER NOT NULL,
    place TEXT NOT NULL, source TEXT NOT NULL, command TEXT NOT NULL, stamp_ns INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (name, version)
) STRICT;
CREATE TABLE appended (name TEXT NOT NULL, request TEXT NOT NULL, version INTEGER NOT NULL) STRICT;
CREATE INDEX appended_request ON appended (name, request);
PRAGMA user_version = {SCHEMA_VERSION};
COMMIT;
"""
_BESIDE = ("", "-wal", "-shm")


def open_file(path: str | Path) -> tuple[sqlite3.Connection, str]:
    """Open the file, or begin one; one that cannot be used is kept beside, untouched, and a new one begun.

    Args:
        path: The file, or ``:memory:``.

    Returns:
        The data base, and what became of a file that could not be used, a sentence; empty if there was none.

    Raises:
        DataError: It cannot be opened.
        StoreError: It cannot be used, and not be moved aside.
    """
    said = ""
    if str(path) != ":memory:" and (fault := _fault(Path(path))):
        aside = _set_aside(Path(path))
        said = f"the object store {path} {fault}; it is kept in {aside}, and a new one is begun: no object is known"
    try:
        db = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=FULL")
        if not db.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
            db.executescript(SCHEMA)
    except sqlite3.Error as error:
        raise DataError(f"the object store {path} cannot be opened: {error}", file=str(path)) from error
    return db, said


def _fault(path: Path) -> str:
    """Why a file cannot be used, a clause; empty if it can. It is only read.

    Raises:
        DataError: It cannot be opened.
    """
    if not path.exists() or not path.stat().st_size:
        return ""
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as db:
            faults = [str(fault) for (fault,) in db.execute("PRAGMA quick_check(3)") if fault != "ok"]
            (version,) = db.execute("PRAGMA user_version").fetchone()
            (tables,) = db.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except sqlite3.Error as error:
        if type(error) is not sqlite3.DatabaseError:  # that is: no data base, or malformed
            raise DataError(f"the object store {path} cannot be opened: {error}", file=str(path)) from error
        return f"is damaged ({error})"
    if faults:
        return f"is damaged ({'; '.join(faults)})"
    if tables and version != SCHEMA_VERSION:
        return f"is of another version of this software ({version}, not {SCHEMA_VERSION})"
    return ""


def _set_aside(path: Path) -> Path:
    """Moves a file, and what SQLite keeps beside it, into a folder of its own."""
    folder, number = path.with_name(f"{path.stem}-damaged-{stamp_name()}"), 1
    while folder.exists():
        number += 1
        folder = path.with_name(f"{path.stem}-damaged-{stamp_name()}-{number}")
    make_folder(folder)
    for end in _BESIDE:
        part = path.with_name(f"{path.name}{end}")
        if part.exists():
            move(part, folder / part.name)
    return folder
