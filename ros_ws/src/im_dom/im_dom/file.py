"""File of the data objects: nothing acknowledged is lost; damage is noticed, reported and set aside.

Each byte is under a checksum. The file of the store is written only when the write-ahead log is moved into it, by
:meth:`StoreFile.move_log`; its checksum stands in the list of transactions (:mod:`im_dom.transactions`). SQLite checks
the log, and that nothing is missing at its end says the list. A file that does not fit is kept beside, untouched, and
what is whole of it (:mod:`im_dom.salvage`) goes to a new one.
"""

import sqlite3
import zlib
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

from im_core.clock import stamp_name
from im_core.errors import DataError, StateError, StoreError
from im_core.file_lock import FileLock
from im_core.files import MEBIBYTE, make_folder, move
from im_core.store_mark import StoreMark
from im_dom.object_record import Damage
from im_dom.salvage import Salvage, salvage
from im_dom.schema import COLUMNS, SCHEMA, SCHEMA_VERSION, record_of, request_checksum, row_of
from im_dom.transactions import Listed, TransactionList, read_list

_LIST, _JOURNAL = "-list", "-journal"
_BESIDE = ("", "-wal", "-shm", _JOURNAL, _LIST)

#: How long the write-ahead log, or the list of its transactions, may be before it is moved into the file [byte].
_MOST_LOG, _MOST_LIST = 4 * MEBIBYTE, MEBIBYTE // 4
#: Errors of SQLite that tell of the computer, not of the file.
_UNREADABLE = {
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_READONLY,
}
#: How many objects a sentence names.
_NAMED = 20


class StoreFile:
    """The file, opened; damage was looked for.

    Args:
        path: The file, made if missing; ``:memory:`` keeps nothing.

    Attributes:
        db: The data base.
        aside: What was found damaged, and what became of it, a sentence; empty if nothing was.
        damaged: What is known of objects that were lost, by name; of the empty name where not all are known.

    Raises:
        DataError: It cannot be opened.
        StateError: Another process has opened it.
        StoreError: It cannot be used, and not be moved aside.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = None if str(path) == ":memory:" else Path(path)
        self._list: TransactionList | None = None
        self._most_log = _MOST_LOG
        self.aside = ""
        found: Salvage | None = None
        if self._path is not None:
            self._lock = _lock(self._path)
            found = self._check(self._path)
        try:
            self.db = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self.db.execute("PRAGMA journal_mode=WAL")
            self.db.execute("PRAGMA synchronous=FULL")
            self.db.execute("PRAGMA wal_autocheckpoint=0")
            if not self.db.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
                self.db.executescript(SCHEMA)
            if found is not None:
                self._fill(found)
            self._number, self._store = self.db.execute("SELECT number, store FROM last").fetchone()
            damaged = self.db.execute("SELECT name, version, why FROM damaged")
            self.damaged = {name: Damage(version, why) for name, version, why in damaged}
            # after `db`: where nobody closes this, Python lets go of its attributes in this order
            self._reader = None if self._path is None else _read_only(self._path)
            if self._reader is not None:
                self._reader.execute("SELECT number FROM last").fetchall()
        except sqlite3.Error as error:
            raise DataError(f"the object store {path} cannot be opened: {error}", file=str(path)) from error
        self.move_log()

    @property
    def mark(self) -> StoreMark:
        """The last transaction that is on the disk; from any thread."""
        return StoreMark(self._store, self._number)

    def number(self) -> None:
        """Assign the next number to the current transaction.

        Raises:
            sqlite3.Error: It cannot be written.
        """
        self.db.execute("UPDATE last SET number = ?", (self._number + 1,))

    def committed(self, changed: Sequence[tuple[str, int, bool]]) -> None:
        """List the transaction now on the disk.

        Args:
            changed: Name, version and validity of the objects that it has changed; version 0: deleted.
        """
        self._number += 1
        if self._path is None:
            return
        if self._list is not None:
            self._list.add(self._number, changed)
        with suppress(OSError):
            log = self._path.with_name(f"{self._path.name}-wal").stat().st_size
            if log > self._most_log or self._list is None or self._list.size > _MOST_LIST:
                self.move_log()
                self._most_log = max(_MOST_LOG, self._path.stat().st_size // 4)

    def move_log(self) -> bool:
        """Move the log into the file; return whether it is there: if the disk refuses the move now, the log stays."""
        if self._path is None:
            return True
        with suppress(sqlite3.Error, OSError):
            if self._list is not None:
                self._list.begin_move()
            (busy, _, _) = self.db.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            if not busy:
                size, checksum = _sum(self._path)
                begun = TransactionList(self._path.with_name(self._path.name + _LIST), size, checksum)
                if self._list is not None:
                    self._list.close()
                self._list = begun
                return True
        return False

    def close(self) -> None:
        """Close the file.

        SQLite moves the log, unlisted, with the end of its last connection if that one may write. So one that may only
        read ends after the other one, also where a process ends without this.

        Raises:
            sqlite3.Error: It cannot be closed.
        """
        if self._reader is not None and self.move_log():
            self._reader.close()
        self.db.close()
        if self._reader is not None:
            self._reader.close()
        if self._list is not None:
            self._list.close()
        if self._path is not None:
            self._lock.release()

    def _check(self, path: Path) -> Salvage | None:
        """Look for damage; if there is any, set the files aside and return the intact content.

        Raises:
            DataError: It cannot be opened.
            StoreError: It cannot be moved aside.
        """
        try:
            _undo_begun(path)
            listed, fault = _look(path)
            if fault.text:  # a disk that has failed once has damaged nothing
                listed, fault = _look(path)
        except OSError as error:
            raise DataError(f"the object store {path} cannot be opened: {error}", file=str(path)) from error
        if not fault.text:
            return None
        try:
            aside = _set_aside(path)
        except OSError as error:
            text = f"the object store {path} {fault.text}, and cannot be moved aside: {error}"
            raise StoreError(text, file=str(path), reason=str(error), errno=error.errno) from error
        self.aside = f"the object store {path} {fault.text}; it is kept in {aside}"
        if fault.foreign:
            self.aside += ", and a new one is begun: no object is known"
            return None
        found = salvage(aside / path.name, listed, mend=fault.file)
        whole, named = len(found.newest().keys() - found.damaged.keys()), sorted(found.damaged.keys() - {""})
        if not found.versions and not named:
            found.damaged.setdefault("", Damage(0, f"nothing is whole of the file that is kept in {aside}"))
        lost = f"damaged: {', '.join(named[:_NAMED])}" if named else "none is known to be damaged"
        if len(named) > _NAMED:
            lost += f" and {len(named) - _NAMED} more"
        if "" in found.damaged:
            lost += f"; {found.damaged[''].text}"
        self.aside += f", and a new one has what is whole of it, {whole} objects; {lost}"
        return found

    def _fill(self, found: Salvage) -> None:
        places = ", ".join("?" * 13)
        rows = [row_of(record, data) for record, data in found.versions]
        requests = [(*each, request_checksum(*each)) for each in found.appended]
        damaged = [(name, damage.version, damage.text) for name, damage in found.damaged.items()]
        self.db.execute("BEGIN")
        self.db.executemany(f"INSERT OR IGNORE INTO versions ({COLUMNS}, data) VALUES ({places})", rows)
        self.db.executemany("INSERT INTO appended VALUES (?, ?, ?, ?)", requests)
        self.db.executemany("INSERT INTO damaged VALUES (?, ?, ?)", damaged)
        self.db.execute("UPDATE last SET number = ?, store = ifnull(nullif(?, ''), store)", (found.number, found.store))
        self.db.execute("COMMIT")


def _undo_begun(path: Path) -> None:
    """Have SQLite undo the begun creation of a store; a rollback journal exists only until the store has its log.

    A death in between leaves the journal, and with it the store cannot be opened for reading alone.
    """
    if path.with_name(path.name + _JOURNAL).exists():
        with suppress(sqlite3.Error), closing(sqlite3.connect(path)) as db:
            db.execute("SELECT count(*) FROM sqlite_schema")


@dataclass(frozen=True)
class _Fault:
    """Why a store cannot be used.

    Attributes:
        text: A clause; empty: it can be.
        file: Whether the file itself may be damaged, not only its log.
        foreign: Whether it is of another version of the software.
    """

    text: str = ""
    file: bool = False
    foreign: bool = False


def _look(path: Path) -> tuple[Listed | None, _Fault]:
    """Look for damage; the files are only read.

    Raises:
        DataError: It cannot be opened.
        OSError: A file cannot be read.
    """
    listed = read_list(path.with_name(path.name + _LIST))
    return listed, _fault(path, listed)


def _fault(path: Path, listed: Listed | None) -> _Fault:
    if not path.exists() or not path.stat().st_size:
        return _Fault("is missing, but its list of transactions exists") if listed else _Fault()
    told = listed.file if listed else None
    if told is not None and (fault := _difference(told, path)):
        return _Fault(f"is damaged ({fault})", file=True)
    try:
        with closing(_read_only(path)) as db:
            db.text_factory = lambda text: text.decode("utf-8", "replace")  # a wrong checksum says more
            return _fault_within(db, listed, checked=told is not None)
    except sqlite3.Error as error:
        if error.sqlite_errorcode & 0xFF in _UNREADABLE:
            raise DataError(f"the object store {path} cannot be opened: {error}", file=str(path)) from error
        return _Fault(f"is damaged ({error})", file=True)


def _lock(path: Path) -> FileLock:
    """Take a file for the own process: of two writers each would number its transactions as the other does.

    Raises:
        DataError: It cannot be locked.
        StateError: Another process has it.
    """
    try:
        return FileLock(path.with_name(f"{path.name}.lock"))
    except StateError as error:
        holder = error.facts["pid"]
        held = f"the object store {path} is in use by process {holder}: one /dom keeps it"
        raise StateError(held, file=str(path), pid=holder) from error
    except StoreError as error:
        reason = error.facts["reason"]
        raise DataError(f"the object store {path} cannot be opened: {reason}", file=str(path)) from error


def _read_only(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, check_same_thread=False)


def _difference(told: tuple[int, int], path: Path) -> str:
    size, checksum = _sum(path)
    if size != told[0]:
        return f"it has {size} bytes, not {told[0]}"
    return "its checksum is wrong" if checksum != told[1] else ""


def _fault_within(db: sqlite3.Connection, listed: Listed | None, checked: bool) -> _Fault:
    """Look for damage in an open file.

    Args:
        db: The file.
        listed: What its list tells.
        checked: Whether its bytes are known to be those that were written.

    Raises:
        sqlite3.Error: It is damaged, or cannot be read.
    """
    if not checked:
        faults = [str(fault) for (fault,) in db.execute("PRAGMA integrity_check(3)") if fault != "ok"]
        if faults:
            return _Fault(f"is damaged ({'; '.join(faults)})", file=True)
    (version,) = db.execute("PRAGMA user_version").fetchone()
    (tables,) = db.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    if version != SCHEMA_VERSION:
        text = f"is of another version of this software ({version}, not {SCHEMA_VERSION})" if tables else ""
        return _Fault(text, foreign=True)
    for row in db.execute(f"SELECT {COLUMNS}, data FROM versions"):
        record, whole = record_of(row)
        if not whole:
            return _Fault(f"is damaged (version {record.version} of {record.name} has a wrong checksum)", file=True)
    for *request, checksum in db.execute("SELECT name, request, version, checksum FROM appended"):
        if request_checksum(*request) != checksum:
            return _Fault(f"is damaged (a request to append to {request[0]} has a wrong checksum)", file=True)
    (number,) = db.execute("SELECT number FROM last").fetchone()
    if listed is None:
        return _Fault("has no list of transactions: its last transaction may be lost") if number else _Fault()
    if listed.last > number:
        return _Fault(f"has lost its transactions {number + 1} to {listed.last}: its write-ahead log is damaged")
    return _Fault(listed.fault and f"is damaged ({listed.fault})")


def _sum(path: Path) -> tuple[int, int]:
    """Return size and checksum of a file.

    Raises:
        OSError: It cannot be read.
    """
    size = checksum = 0
    with path.open("rb") as file:
        while part := file.read(MEBIBYTE):
            size, checksum = size + len(part), zlib.crc32(part, checksum)
    return size, checksum


def _set_aside(path: Path) -> Path:
    """Move a file, with the companion files, into a separate folder."""
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
