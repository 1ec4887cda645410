"""Data objects in SQLite: typed bytes with versions, a validity, and where they come from."""

import re
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from im_core.errors import DataError, ImError, NotFoundError, StateError, StoreError
from im_core.files import MEBIBYTE
from im_dom.file import open_file

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_./-]{0,127}(?<!/)")
TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
PLACE = re.compile(r"[A-Za-z][A-Za-z0-9_]*\.[A-Za-z][A-Za-z0-9_.]*")

LARGEST = 64 * MEBIBYTE
"""Largest object [bytes]."""

KEPT_VERSIONS, KEPT_BYTES = 8, LARGEST
"""How many versions of an object are kept, and how many bytes the older ones of it may have; the newest always is."""

KEPT_REQUESTS = 10_000
"""How many requests to append are remembered, so that one that is made again has no second effect."""

COLUMNS = "name, version, type, hash, valid, place, source, command, stamp_ns, length(data)"
_OF_A_COMMAND = re.compile(r"[A-Za-z][A-Za-z0-9_]*/\d+-\d+-\d+(?=/)")


@dataclass(frozen=True)
class ObjectRecord:
    """What is known of a data object, without its data.

    Attributes:
        name: Its name.
        version: Counts the puts from 1.
        type: ROS type, e.g. ``geometry_msgs/msg/Pose``.
        hash: Of the definition of that type (REP 2016).
        valid: Whether it may be used.
        place: ``net.place`` that stands for its existence and validity, or empty.
        source: Who changed it last.
        command: The command that it was put for, ``<node>/<life of the node>-<number>``, or empty.
        stamp_ns: Testbed time of the last change [ns].
        size: Of the data [byte].
    """

    name: str
    version: int
    type: str
    hash: str
    valid: bool
    place: str
    source: str
    command: str
    stamp_ns: int
    size: int


class ObjectStore:
    """The data objects of one machine, in one file.

    Each change is made whole or not at all, and is on the disk when its method returns: it outlives the death of the
    process and the loss of power. All methods raise a :class:`.StoreError` where the file cannot be written or read
    (the disk is full or has failed); what was stored before is still there then.

    Args:
        path: SQLite file, made if missing; ``:memory:`` keeps nothing.

    Attributes:
        aside: What became of a file that was there and could not be used, a sentence; empty if there was none.

    Raises:
        DataError: It cannot be opened.
        StoreError: It cannot be used, and not be moved aside.
    """

    def __init__(self, path: str | Path = ":memory:") -> None:
        self._path = str(path)
        self._db, self.aside = open_file(path)
        with self._doing("written"):
            self._db.execute(_keep_older())

    def together(self, works: Sequence[Callable[[], object]]) -> list[object]:
        """Do several things, in their order, with one wait for the disk.

        Returns:
            What each has returned, or the exception that it has raised; what is said to be done is on the disk. Where
            the file cannot be written, or something breaks, they are done one by one, so that one that fails does not
            take others along.
        """
        if len(works) > 1:
            with suppress(Exception), self._transaction():
                return [self._answer(work) for work in works]
        found: list[object] = []
        for work in works:
            try:
                with self._transaction():
                    answer = work()
            except Exception as error:  # it is raised where the work was asked for
                answer = error
            found.append(answer)
        return found

    @staticmethod
    def _answer(work: Callable[[], object]) -> object:
        """What something returns, or why it was refused, which is so before it changes anything."""
        try:
            return work()
        except StoreError:
            raise
        except ImError as error:
            return error

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """What is changed within is changed together when the outermost is left, or not at all."""
        if self._db.in_transaction:
            yield
            return
        with self._doing("written"):
            self._db.execute("BEGIN")
        try:
            yield
            with self._doing("written"):
                self._db.execute("COMMIT")
        except BaseException:
            with self._doing("written"):
                if self._db.in_transaction:  # SQLite may have undone all
                    self._db.execute("ROLLBACK")
            raise

    @contextmanager
    def _doing(self, what: str) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise StoreError(
                f"the object store {self._path} cannot be {what}: {error}", file=self._path, reason=str(error)
            ) from error

    def put(
        self,
        name: str,
        kind: str,
        data: bytes,
        place: str,
        source: str,
        stamp_ns: int,
        *,
        kind_hash: str = "",
        command: str = "",
    ) -> ObjectRecord:
        """Store an object and make it valid; older versions are kept, within :data:`KEPT_VERSIONS`.

        Args:
            name: Its name; what belongs to a command begins with that.
            kind: ROS type.
            data: The message as CDR.
            place: ``net.place`` that stands for it, or empty.
            source: Who puts it.
            stamp_ns: Testbed time [ns].
            kind_hash: Of the definition of the type.
            command: The command that it is put for; empty: the one that its name begins with, if it does.

        Raises:
            DataError: Name, type or place is not well formed, or it is too large.
        """
        letters = "letters, digits and _ . / -, at most 128, a letter first, no / last"
        _match(NAME, "name of a data object", name, letters)
        _match(TYPE, "type of a data object", kind, "package/msg/Name")
        if place:
            _match(PLACE, "place of a data object", place, "net.place")
        if len(data) > LARGEST:
            text = f"data object '{name}' has {len(data)} bytes; at most {LARGEST} ({LARGEST // MEBIBYTE} MiB) are kept"
            raise DataError(text, object=name, size=len(data), allowed=LARGEST)
        found = _OF_A_COMMAND.match(name)
        command = command or (found[0] if found else "")
        with self._transaction(), self._doing("written"):
            row = self._db.execute(
                "INSERT INTO objects VALUES (?, 1, ?, ?, 1, ?, ?, ?, ?, ?) ON CONFLICT (name) DO UPDATE SET"
                " version = version + 1, type = excluded.type, hash = excluded.hash, valid = 1,"
                " place = excluded.place, source = excluded.source, command = excluded.command,"
                f" stamp_ns = excluded.stamp_ns, data = excluded.data RETURNING {COLUMNS}",
                (name, kind, kind_hash, place, source, command, stamp_ns, data),
            ).fetchone()
        return _record(row)

    def append(
        self,
        name: str,
        kind: str,
        extend: Callable[[bytes], bytes],
        source: str,
        stamp_ns: int,
        *,
        request: str = "",
    ) -> ObjectRecord:
        """Store an object as it has grown; as with :meth:`put`, the version before is kept.

        Args:
            name: Its name.
            kind: Its ROS type.
            extend: Returns its data with what is appended.
            source: Who appends.
            stamp_ns: Testbed time [ns].
            request: Names the request; one that had its effect before, among the last :data:`KEPT_REQUESTS`, has none.

        Returns:
            The object; its place and command are those that it was put for.

        Raises:
            NotFoundError: There is none of that name.
            StateError: It is not valid.
            DataError: It is of another type, or would be too large; or as ``extend`` raises.
        """
        with self._transaction():
            if request and (version := self._appended(name, request)) is not None:
                return replace(self.record(name), version=version)
            record, data = self.get(name, kind)
            longer = extend(data)
            after = self.put(
                name, kind, longer, record.place, source, stamp_ns, kind_hash=record.hash, command=record.command
            )
            if request:
                with self._doing("written"):
                    self._db.execute("INSERT INTO appended VALUES (?, ?, ?)", (name, request, after.version))
                    self._db.execute("DELETE FROM appended WHERE rowid <= last_insert_rowid() - ?", (KEPT_REQUESTS,))
            return after

    def _appended(self, name: str, request: str) -> int | None:
        """The version that a request to append has made; None if it has not had its effect yet."""
        with self._doing("read"):
            row = self._db.execute(
                "SELECT version FROM appended WHERE name = ? AND request = ?", (name, request)
            ).fetchone()
        return None if row is None else int(row[0])

    def record(self, name: str, version: int = 0) -> ObjectRecord:
        """What is known of an object.

        Args:
            name: Its name.
            version: One that is kept; 0: the newest.

        Raises:
            NotFoundError: There is none of that name, or that version is not kept.
        """
        with self._doing("read"):
            row = self._db.execute(f"SELECT {COLUMNS} FROM objects WHERE name = ?", (name,)).fetchone()
            if row is not None and version not in (0, row[1]):
                newest = row[1]
                row = self._db.execute(
                    f"SELECT {COLUMNS} FROM older WHERE name = ? AND version = ?", (name, version)
                ).fetchone()
                if row is None:
                    kept = [str(each) for (each,) in self._older(name)]
                    raise NotFoundError(
                        kind=f"version of data object '{name}'", name=str(version), known=[*kept, str(newest)]
                    )
        if row is None:
            raise NotFoundError(kind="data object", name=name, known=[record.name for record in self.records()])
        return _record(row)

    def _older(self, name: str) -> list[tuple[int]]:
        return self._db.execute("SELECT version FROM older WHERE name = ? ORDER BY version", (name,)).fetchall()

    def get(self, name: str, kind: str = "", version: int = 0) -> tuple[ObjectRecord, bytes]:
        """A valid object, or an older version of one, which was valid once.

        Args:
            name: Its name.
            kind: The type it must have; empty: any.
            version: One that is kept; 0: the newest, which must be valid.

        Raises:
            NotFoundError: There is none of that name, or that version is not kept.
            StateError: It is not valid.
            DataError: It is of another type.
        """
        record = self.valid_record(name, version)
        if kind and kind != record.type:
            raise DataError(f"data object '{name}' is a {record.type}, not a {kind}", object=name, type=record.type)
        with self._doing("read"):
            row = self._db.execute(
                "SELECT data FROM objects WHERE name = ?1 AND version = ?2"
                " UNION ALL SELECT data FROM older WHERE name = ?1 AND version = ?2",
                (name, record.version),
            ).fetchone()
        return record, row[0]

    def valid_record(self, name: str, version: int = 0) -> ObjectRecord:
        """What is known of an object that :meth:`get` would give; raises as that."""
        record = self.record(name, version)
        if not version and not record.valid:
            raise StateError(
                f"data object '{name}' (version {record.version}) is not valid; {record.source} invalidated it",
                object=name,
                version=record.version,
            )
        return record

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
        with self._transaction(), self._doing("written"):
            self._db.execute(
                "UPDATE objects SET valid = 0, source = ?, stamp_ns = ? WHERE name = ?", (source, stamp_ns, name)
            )
            return self.record(name)

    def forget(self, prefix: str) -> list[ObjectRecord]:
        """Deletes all objects whose name begins with ``prefix``, with all their versions.

        Returns:
            Those that were valid; they are not any more.
        """
        gone = [replace(record, valid=False) for record in self.records(prefix) if record.valid]
        with self._transaction(), self._doing("written"):
            for table in ("objects", "older", "appended"):
                self._db.execute(f"DELETE FROM {table} WHERE substr(name, 1, ?) = ?", (len(prefix), prefix))
        return gone

    def close(self) -> None:
        """Close the file."""
        with self._doing("closed"):
            self._db.close()


def _keep_older() -> str:
    """What moves the newest version of an object to the older ones, and deletes those that are too many or too large.

    It is done by SQLite, with the statement that puts the next: each other one costs a change of threads.
    """
    return f"""
        CREATE TEMP TRIGGER keep_older BEFORE UPDATE OF version ON main.objects BEGIN
            INSERT INTO older SELECT * FROM objects WHERE name = OLD.name;
            DELETE FROM older WHERE name = OLD.name AND (version <= OLD.version + 1 - {KEPT_VERSIONS} OR (
                SELECT sum(length(data)) FROM older AS newer
                WHERE newer.name = OLD.name AND newer.version >= older.version
            ) > {KEPT_BYTES});
        END
    """


def _match(pattern: re.Pattern[str], what: str, value: str, allowed: str) -> None:
    if not pattern.fullmatch(value):
        raise DataError(f"the {what} '{value}' is not allowed: {allowed}", value=value)


def _record(row: tuple[str, int, str, str, int, str, str, str, int, int]) -> ObjectRecord:
    name, version, kind, kind_hash, valid, place, source, command, stamp_ns, size = row
    return ObjectRecord(name, version, kind, kind_hash, bool(valid), place, source, command, stamp_ns, size)
