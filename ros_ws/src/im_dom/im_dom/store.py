"""Data objects in SQLite: typed bytes with versions, a validity, and the origin."""

import re
import sqlite3
import zlib
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from itertools import chain, groupby
from pathlib import Path
from typing import TypeVar

from im_core.errors import DataError, ImError, NotFoundError, StateError, StoreError
from im_core.files import MEBIBYTE
from im_core.store_mark import StoreMark
from im_dom.cache import ObjectCache, Version
from im_dom.file import StoreFile
from im_dom.object_record import Damage, DamagedObjectError, ObjectRecord
from im_dom.places import check_form
from im_dom.schema import COLUMNS, record_of, request_checksum, row_of

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_./-]{0,127}(?<!/)")
TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")

LARGEST = 64 * MEBIBYTE
"""Largest object [bytes]."""

KEPT_VERSIONS, KEPT_BYTES = 8, LARGEST
"""How many versions of an object are kept, and how many bytes the older ones of it may have; the newest always is."""

CACHED_BYTES = 16 * MEBIBYTE
"""How many bytes of newest versions are kept in memory, too."""

KEPT_REQUESTS = 10_000
"""How many requests to append are remembered, so that one that is made again has no second effect."""

_ROW, _VERSION = f"(?{', ?' * 12})", "(name = ? AND version = ?)"

#: How many rows a statement writes or deletes, and how many bytes of data it may have if they are more than one.
_AT_ONCE, _BYTES_AT_ONCE = 64, MEBIBYTE
_WITHIN = nullcontext()
_OF_A_COMMAND = re.compile(r"[A-Za-z][A-Za-z0-9_]*/\d+-\d+-\d+(?=/)")

Versions = tuple[ObjectRecord, ...]
PieceT = TypeVar("PieceT")


class ObjectStore:
    """The data objects of one machine, in one file.

    Each change is made whole or not at all, and is on the disk when its method returns: it outlives the death of the
    process and the loss of power. What is known of the versions is in memory, too. All methods raise a
    :class:`.StoreError` where the file cannot be written or read (the disk is full or has failed); what was stored
    before is still there then. An object that was found damaged is answered with a :class:`.DamagedObjectError` until
    it is put again.

    Args:
        path: SQLite file, made if missing; ``:memory:`` keeps nothing.

    Attributes:
        aside: What was found damaged in a file that was there, a sentence; empty if nothing was.

    Raises:
        DataError: It cannot be opened.
        StoreError: It cannot be used, and not be moved aside.
    """

    def __init__(self, path: str | Path = ":memory:") -> None:
        self._path = str(path)
        self._file = StoreFile(path)
        self._db, self.aside = self._file.db, self._file.aside
        self._damaged = self._file.damaged
        self._kept: dict[str, Versions] = {}
        self._changed: dict[str, Versions] = {}  # by the transaction that goes on, as what follows
        self._rows: list[tuple[ObjectRecord, bytes]] = []
        self._too_old: list[tuple[str, int]] = []
        self._data: dict[str, bytes] = {}  # of newest versions
        self._cache = ObjectCache(CACHED_BYTES)
        with self._doing("read"):
            rows = self._db.execute(f"SELECT {COLUMNS} FROM versions ORDER BY name, version")
            for name, group in groupby((record_of(row)[0] for row in rows), key=lambda record: record.name):
                self._kept[name] = tuple(group)

    def together(self, works: Sequence[Callable[[], object]]) -> list[object]:
        """Run several operations, in the order, with one wait for the disk.

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
        """Return the result of an operation, or the refusal, which comes before any change."""
        try:
            return work()
        except StoreError:
            raise
        except ImError as error:
            return error

    def _transaction(self) -> AbstractContextManager[None]:
        """Run a transaction: the changes are made together at the end of the outermost one, or not at all."""
        return _WITHIN if self._db.in_transaction else self._outermost()

    @contextmanager
    def _outermost(self) -> Iterator[None]:
        with self._doing("written"):
            self._db.execute("BEGIN")
        try:
            yield
            self._write()
            with self._doing("written"):
                if self._changed:
                    self._file.number()
                self._db.execute("COMMIT")
        except BaseException:
            with self._doing("written"):
                if self._db.in_transaction:  # SQLite may have undone all
                    self._db.execute("ROLLBACK")
            raise
        else:
            self._keep()
        finally:
            for each in (self._changed, self._rows, self._too_old, self._data):
                each.clear()

    def _write(self) -> None:
        """Write the pending rows to SQLite, many a statement: with single rows the threads would alternate."""
        with self._doing("written"):
            few = _AT_ONCE if sum(len(data) for _, data in self._rows) <= _BYTES_AT_ONCE else 1  # SQLite copies them
            for rows in _pieces(self._rows, few):
                places = ", ".join([_ROW] * len(rows))
                values = [*chain.from_iterable(row_of(record, data) for record, data in rows)]
                self._db.execute(f"INSERT INTO versions ({COLUMNS}, data) VALUES {places}", values)
            for versions in _pieces(self._too_old, _AT_ONCE):
                which = " OR ".join([_VERSION] * len(versions))
                self._db.execute(f"DELETE FROM versions WHERE {which}", [*chain(*versions)])
            for name in self._damaged.keys() & self._changed.keys():
                self._db.execute("DELETE FROM damaged WHERE name = ?", (name,))
        self._rows.clear()
        self._too_old.clear()

    def _keep(self) -> None:
        """Take over the changes and reads of the transaction, now on the disk."""
        if self._changed:
            changed = [(name, its[-1] if its else None) for name, its in self._changed.items()]
            self._file.committed([(name, its.version, its.valid) if its else (name, 0, False) for name, its in changed])
        for name, versions in self._changed.items():
            self._damaged.pop(name, None)
            if versions:
                self._kept[name] = versions
            else:
                self._kept.pop(name, None)
        known: dict[str, Version | None] = dict.fromkeys(self._changed)
        for name, data in self._data.items():
            newest = self._kept[name][-1] if name in self._kept else None
            known[name] = (newest, data) if newest and newest.valid else None
        self._cache.update(known)

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
        """Store an object and make the object valid; older versions are kept, within :data:`KEPT_VERSIONS`.

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
            check_form(place)
        if len(data) > LARGEST:
            text = f"data object '{name}' has {len(data)} bytes; at most {LARGEST} ({LARGEST // MEBIBYTE} MiB) are kept"
            raise DataError(text, object=name, size=len(data), allowed=LARGEST)
        found = _OF_A_COMMAND.match(name)
        command = command or (found[0] if found else "")
        with self._transaction():
            before = self._versions(name)
            damage = self._damage(name)
            version = max(before[-1].version if before else 0, damage.version if damage else 0) + 1
            size, checksum = len(data), zlib.crc32(data)
            record = ObjectRecord(
                name, version, kind, kind_hash, True, place, source, command, stamp_ns, size, checksum
            )
            kept = _kept((*before, record))
            self._rows.append((record, data))
            self._too_old += [(name, old.version) for old in before[: len(before) + 1 - len(kept)]]
            self._changed[name], self._data[name] = kept, data
        return record

    def _versions(self, name: str) -> Versions:
        """Return the records of the kept versions of an object, the newest last; empty without the object."""
        changed = self._changed.get(name)
        return self._kept.get(name, ()) if changed is None else changed

    def _damage(self, name: str) -> Damage | None:
        """Return the damage record of a lost object; None if the object was not lost, or has been put again."""
        return None if name in self._changed else self._damaged.get(name)

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
        """Store a grown object; as with :meth:`put`, the version before is kept.

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
                    checksum = request_checksum(name, request, after.version)
                    self._db.execute(
                        "INSERT INTO appended VALUES (?, ?, ?, ?)", (name, request, after.version, checksum)
                    )
                    self._db.execute("DELETE FROM appended WHERE rowid <= last_insert_rowid() - ?", (KEPT_REQUESTS,))
            return after

    def _appended(self, name: str, request: str) -> int | None:
        """Return the version made by a request to append; None without the effect so far."""
        with self._doing("read"):
            row = self._db.execute(
                "SELECT version FROM appended WHERE name = ? AND request = ?", (name, request)
            ).fetchone()
        return None if row is None else int(row[0])

    def record(self, name: str, version: int = 0) -> ObjectRecord:
        """Return the record of an object.

        Args:
            name: Its name.
            version: One that is kept; 0: the newest.

        Raises:
            NotFoundError: There is none of that name, or that version is not kept.
            DamagedObjectError: It was there, or may have been there, and is lost.
        """
        versions, damage = self._versions(name), self._damage(name)
        if damage is not None and version in (0, damage.version):
            raise DamagedObjectError(self._path, name, damage.text)
        if not versions and (unnamed := self._damaged.get("")):
            raise DamagedObjectError(self._path, name, f"a record without a name is damaged: {unnamed.text}")
        if not versions:
            raise NotFoundError(kind="data object", name=name, known=[record.name for record in self.records()])
        for record in versions:
            if record.version == (version or versions[-1].version):
                return record
        known = [str(record.version) for record in versions]
        raise NotFoundError(kind=f"version of data object '{name}'", name=str(version), known=known)

    def get(self, name: str, kind: str = "", version: int = 0) -> tuple[ObjectRecord, bytes]:
        """Return a valid object, or an older version, valid once.

        Args:
            name: Its name.
            kind: The type it must have; empty: any.
            version: One that is kept; 0: the newest, which must be valid.

        Raises:
            NotFoundError: There is none of that name, or that version is not kept.
            StateError: It is not valid.
            DataError: It is of another type.
            DamagedObjectError: It is damaged.
        """
        record = self.valid_record(name, version)
        if kind and kind != record.type:
            raise DataError(f"data object '{name}' is a {record.type}, not a {kind}", object=name, type=record.type)
        with self._transaction():
            return record, self._read(record)

    def _read(self, record: ObjectRecord) -> bytes:
        """Return the data of a kept version.

        Raises:
            DamagedObjectError: They are not those that were stored.
        """
        newest = record.version == self._versions(record.name)[-1].version
        if newest and record.name in self._data:
            return self._data[record.name]
        if newest and record.name not in self._changed and (cached := self._cache.get(record.name)):
            return cached[1]
        self._write()
        with self._doing(f"read for data object '{record.name}'"):
            row = self._db.execute(
                "SELECT data FROM versions WHERE name = ? AND version = ?", (record.name, record.version)
            ).fetchone()
        if row is None or not record.fits(row[0]):
            text = f"the bytes of its version {record.version} are damaged"
            raise DamagedObjectError(self._path, record.name, text)
        data: bytes = row[0]
        if newest:
            self._data[record.name] = data
        return data

    def cached(self, name: str) -> Version | None:
        """Return the newest version of an object, from memory; from any thread, without a wait.

        Returns:
            As of :meth:`get`, and on the disk; None if it is not in memory, not valid, or not there.
        """
        return self._cache.get(name)

    @property
    def mark(self) -> StoreMark:
        """The identity of the store, and the last transaction that is on the disk; from any thread."""
        return self._file.mark

    def valid_record(self, name: str, version: int = 0) -> ObjectRecord:
        """Return the record of an object valid for :meth:`get`; raise as :meth:`get` does."""
        record = self.record(name, version)
        if not version and not record.valid:
            who = record.source or "somebody"
            raise StateError(
                f"data object '{name}' (version {record.version}) is not valid; {who} invalidated it",
                object=name,
                version=record.version,
            )
        return record

    def records(self, prefix: str = "") -> list[ObjectRecord]:
        """Return all objects with names beginning with ``prefix``, sorted; for damaged ones see :meth:`damages`."""
        names = sorted(name for name in {**self._kept, **self._changed} if name.startswith(prefix))
        return [versions[-1] for name in names if (versions := self._versions(name)) and not self._damage(name)]

    def damages(self, prefix: str = "") -> list[str]:
        """Return a sentence for each damaged object with a name beginning with ``prefix``."""
        known = sorted(self._damaged.items())
        return [
            DamagedObjectError(self._path, name, damage.text).message
            for name, damage in known
            if name.startswith(prefix) or not name
        ]

    def invalidate(self, name: str, source: str, stamp_ns: int) -> ObjectRecord:
        """Declare an object invalid; the object stays listed.

        Raises:
            NotFoundError: There is none of that name.
        """
        record = replace(self.record(name), valid=False, source=source, stamp_ns=stamp_ns)
        with self._transaction(), self._doing("written"):
            self._write()
            self._db.execute(
                "UPDATE versions SET valid = 0, source = ?, stamp_ns = ?, checksum = ? WHERE name = ? AND version = ?",
                (source, stamp_ns, record.checksum(), name, record.version),
            )
            self._changed[name] = (*self._versions(name)[:-1], record)
        return record

    def abandon(self, net: str, places: Container[str], source: str, stamp_ns: int) -> list[ObjectRecord]:
        """Declare the objects of removed places of a net invalid.

        Args:
            net: Its name.
            places: Those that it has.
            source: Who says so.
            stamp_ns: Testbed time [ns].

        Returns:
            The objects.
        """
        with self._transaction():
            stood = [(record, record.place.partition(".")) for record in self.records() if record.valid]
            gone = [record.name for record, (its, _, place) in stood if its == net and place not in places]
            return [self.invalidate(name, source, stamp_ns) for name in gone]

    def forget(self, prefix: str) -> list[ObjectRecord]:
        """Delete all objects with a name prefix ``prefix``, with all the versions.

        Returns:
            Those that were valid; they are not any more.
        """
        known = self.records(prefix)
        with self._transaction(), self._doing("written"):
            self._write()
            for table in ("versions", "appended"):
                self._db.execute(f"DELETE FROM {table} WHERE substr(name, 1, ?) = ?", (len(prefix), prefix))
            self._changed.update({record.name: () for record in known})
            self._changed.update({name: () for name in self._damaged if name.startswith(prefix)})
            self._write()
        return [replace(record, valid=False) for record in known if record.valid]

    def close(self) -> None:
        """Close the file."""
        with self._doing("closed"):
            self._file.close()


def _kept(versions: Versions) -> Versions:
    """Return the newest rows up to the largest kept number; the newest is last."""
    first = max(0, len(versions) - KEPT_VERSIONS)
    while sum(record.size for record in versions[first:-1]) > KEPT_BYTES:
        first += 1
    return versions[first:]


def _pieces(rows: Sequence[PieceT], most: int) -> Iterator[Sequence[PieceT]]:
    """Cut rows into pieces of few lengths, powers of two, so SQLite knows the statements already."""
    first = 0
    while first < len(rows):
        length = min(most, 1 << (len(rows) - first).bit_length() - 1)
        yield rows[first : first + length]
        first += length


def _match(pattern: re.Pattern[str], what: str, value: str, allowed: str) -> None:
    if not pattern.fullmatch(value):
        raise DataError(f"the {what} '{value}' is not allowed: {allowed}", value=value)
