"""Data objects in SQLite: typed bytes with a version and a validity."""

import re
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from im_core.errors import DataError, NotFoundError, StateError, StoreError

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_./-]{0,127}")
TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
PLACE = re.compile(r"[A-Za-z][A-Za-z0-9_]*\.[A-Za-z][A-Za-z0-9_.]*")

SCHEMA = """
CREATE TABLE IF NOT EXISTS objects (
    name TEXT PRIMARY KEY, type TEXT NOT NULL, version INTEGER NOT NULL, valid INTEGER NOT NULL,
    place TEXT NOT NULL, source TEXT NOT NULL, stamp_ns INTEGER NOT NULL, data BLOB NOT NULL
) STRICT
"""
COLUMNS = "name, type, version, valid, place, source, stamp_ns, length(data)"


@dataclass(frozen=True)
class ObjectRecord:
    """What is known of a data object, without its data.

    Attributes:
        name: Its name.
        type: ROS type, e.g. ``geometry_msgs/msg/Pose``.
        version: Counts the puts from 1.
        valid: Whether it may be used.
        place: ``net.place`` that stands for its existence and validity, or empty.
        source: Who changed it last.
        stamp_ns: Testbed time of the last change [ns].
        size: Of the data [byte].
    """

    name: str
    type: str
    version: int
    valid: bool
    place: str
    source: str
    stamp_ns: int
    size: int


class ObjectStore:
    """The data objects of one machine, in one file.

    Each change is made whole or not at all. All methods raise a :class:`.StoreError` where the file cannot be written
    or read (the disk is full or has failed); what was stored before is still there then.

    Args:
        path: SQLite file, made if missing; ``:memory:`` keeps nothing.

    Raises:
        DataError: It cannot be opened.
    """

    def __init__(self, path: str | Path = ":memory:") -> None:
        self._path = str(path)
        try:
            self._db = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=NORMAL")
            self._db.execute(SCHEMA)
        except sqlite3.Error as error:
            raise DataError(f"the object store {path} cannot be opened: {error}", file=str(path)) from error

    @contextmanager
    def _doing(self, what: str) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise StoreError(
                f"the object store {self._path} cannot be {what}: {error}", file=self._path, reason=str(error)
            ) from error

    def put(self, name: str, kind: str, data: bytes, place: str, source: str, stamp_ns: int) -> ObjectRecord:
        """Store an object and make it valid.

        Raises:
            DataError: Name, type or place is not well formed.
        """
        _match(NAME, "name of a data object", name, "letters, digits and _ . / -, at most 128, a letter first")
        _match(TYPE, "type of a data object", kind, "package/msg/Name")
        if place:
            _match(PLACE, "place of a data object", place, "net.place")
        with self._doing("written"):
            self._db.execute(
                "INSERT INTO objects VALUES (?, ?, 1, 1, ?, ?, ?, ?) ON CONFLICT (name) DO UPDATE SET"
                " type = excluded.type, version = version + 1, valid = 1, place = excluded.place,"
                " source = excluded.source, stamp_ns = excluded.stamp_ns, data = excluded.data",
                (name, kind, place, source, stamp_ns, data),
            )
        return self.record(name)

    def record(self, name: str) -> ObjectRecord:
        """What is known of an object.

        Raises:
            NotFoundError: There is none of that name.
        """
        with self._doing("read"):
            row = self._db.execute(f"SELECT {COLUMNS} FROM objects WHERE name = ?", (name,)).fetchone()
        if row is None:
            raise NotFoundError(kind="data object", name=name, known=[record.name for record in self.records()])
        return _record(row)

    def get(self, name: str, kind: str = "") -> tuple[ObjectRecord, bytes]:
        """A valid object.

        Args:
            name: Its name.
            kind: The type it must have; empty: any.

        Raises:
            NotFoundError: There is none of that name.
            StateError: It is not valid.
            DataError: It is of another type.
        """
        record = self.record(name)
        if not record.valid:
            raise StateError(
                f"data object '{name}' (version {record.version}) is not valid; {record.source} invalidated it",
                object=name,
                version=record.version,
            )
        if kind and kind != record.type:
            raise DataError(f"data object '{name}' is a {record.type}, not a {kind}", object=name, type=record.type)
        with self._doing("read"):
            (data,) = self._db.execute("SELECT data FROM objects WHERE name = ?", (name,)).fetchone()
        return record, bytes(data)

    def records(self, prefix: str = "") -> list[ObjectRecord]:
        """All objects whose name begins with ``prefix``, by name."""
        with self._doing("read"):
            rows = self._db.execute(
                f"SELECT {COLUMNS} FROM objects WHERE substr(name, 1, ?) = ? ORDER BY name", (len(prefix), prefix)
            ).fetchall()
        return [_record(row) for row in rows]

    def invalidate(self, name: str, source: str, stamp_ns: int) -> ObjectRecord:
        """Declare an object invalid; it stays listed.

        Raises:
            NotFoundError: There is none of that name.
        """
        self.record(name)
        with self._doing("written"):
            self._db.execute(
                "UPDATE objects SET valid = 0, source = ?, stamp_ns = ? WHERE name = ?", (source, stamp_ns, name)
            )
        return self.record(name)

    def close(self) -> None:
        """Write everything and close the file."""
        with self._doing("closed"):
            self._db.close()


def _match(pattern: re.Pattern[str], what: str, value: str, allowed: str) -> None:
    if not pattern.fullmatch(value):
        raise DataError(f"the {what} '{value}' is not allowed: {allowed}", value=value)


def _record(row: tuple[str, str, int, int, str, str, int, int]) -> ObjectRecord:
    name, kind, version, valid, place, source, stamp_ns, size = row
    return ObjectRecord(name, kind, version, bool(valid), place, source, stamp_ns, size)
