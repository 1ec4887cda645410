"""Salvage of a damaged object store: intact content and losses."""

import shutil
import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from im_core.errors import DataError
from im_core.store_mark import StoreMark
from im_dom.object_record import Damage, ObjectRecord
from im_dom.schema import COLUMNS, PAGE, SCHEMA, record_of, request_checksum
from im_dom.transactions import Listed

_INDEX = "sqlite_autoindex_versions_1"
_KEYS = f"SELECT name, version, rowid FROM versions INDEXED BY {_INDEX} ORDER BY name {{0}}, version {{0}}"
_ROWS = "SELECT rowid FROM versions NOT INDEXED ORDER BY rowid {0}"
_NAMELESS = "pages are damaged, and which objects they held is not known"
_PAGES_AT = 28  # where the first page tells how many there are


@dataclass
class Salvage:
    """Content found in a damaged store.

    Attributes:
        versions: The versions that are whole.
        appended: Requests to append that are remembered.
        damaged: What is lost, by name; of the empty name what nobody can name.
        number: Of the last transaction.
        store: Identity of the store; empty: it cannot be read.
    """

    versions: list[tuple[ObjectRecord, bytes]] = field(default_factory=list)
    appended: list[tuple[str, str, int]] = field(default_factory=list)
    damaged: dict[str, Damage] = field(default_factory=dict)
    number: int = 0
    store: str = ""

    def newest(self) -> dict[str, ObjectRecord]:
        """Return the newest whole version of each object, by name."""
        newest: dict[str, ObjectRecord] = {}
        for record, _ in self.versions:
            if record.name not in newest or newest[record.name].version < record.version:
                newest[record.name] = record
        return newest


def salvage(path: Path, listed: Listed | None, mend: bool) -> Salvage:
    """Read the intact content of a store without changing the files.

    Args:
        path: File of the store.
        listed: What its list of transactions tells; None: there is none.
        mend: Whether the first page, which tells where the tables are, may be damaged: these are always at one place.
    """
    found = Salvage(number=listed.last if listed else 0)
    with TemporaryDirectory(prefix="im_salvage_", dir=path.parent) as folder:
        copy = Path(folder) / path.name
        for end in ("", "-wal"):
            if (part := path.with_name(f"{path.name}{end}")).exists():
                shutil.copyfile(part, f"{copy}{end}")
        if mend and copy.exists():
            _mend_first_page(copy)
        with suppress(sqlite3.Error), closing(sqlite3.connect(copy)) as db:
            db.text_factory = lambda text: text.decode("utf-8", "replace")
            _read(db, found)
    if listed is not None:
        _compare(found, listed)
    return found


def _mend_first_page(copy: Path) -> None:
    fresh = copy.with_name("fresh")
    with closing(sqlite3.connect(fresh, isolation_level=None)) as db:
        db.execute("PRAGMA journal_mode=WAL")
        db.executescript(SCHEMA)
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    page = bytearray(fresh.read_bytes()[:PAGE])
    page[_PAGES_AT : _PAGES_AT + 4] = (copy.stat().st_size // PAGE).to_bytes(4, "big")
    with copy.open("r+b") as file:
        file.write(page)


def _read(db: sqlite3.Connection, found: Salvage) -> None:
    """Read all rows listed in a table or an index."""
    rows, keys = _Scan(db, _ROWS), _Scan(db, _KEYS)  # table and index name the same rows; damage seldom hits both
    known = {rowid: (name, version) for name, version, rowid in keys.rows}
    lost: dict[str, int] = {}
    for rowid in sorted({row for (row,) in rows.rows} | known.keys()):
        name, version = known.get(rowid, ("", 0))
        with suppress(sqlite3.Error):
            select = f"SELECT {COLUMNS}, data FROM versions NOT INDEXED WHERE rowid = ?"
            row = next(iter(db.execute(select, (rowid,))), None)
            if row is not None:
                record, intact = record_of(row)
                if intact:
                    found.versions.append((record, row[-1]))
                    continue
                if not name:
                    name, version = record.name, record.version
        if isinstance(name, str) and isinstance(version, int) and name:
            lost[name] = max(version, lost.get(name, 0))
        else:
            found.damaged[""] = Damage(0, _NAMELESS)
    newest = found.newest()
    for name, version in lost.items():
        if name not in newest or version > newest[name].version:
            found.damaged[name] = Damage(version, f"the bytes of its version {version} are damaged")
    if not (rows.whole or keys.whole):  # either alone names every row
        found.damaged[""] = Damage(0, _NAMELESS)
    for name, version, text in _Scan(db, "SELECT name, version, why FROM damaged NOT INDEXED ORDER BY rowid {0}").rows:
        if isinstance(name, str) and isinstance(version, int) and isinstance(text, str):
            found.damaged.setdefault(name, Damage(version, text))
    select = "SELECT name, request, version, checksum FROM appended NOT INDEXED ORDER BY rowid {0}"
    for name, request, version, checksum in _Scan(db, select).rows:
        if checksum == request_checksum(name, request, version):
            found.appended.append((name, request, version))
    with suppress(sqlite3.Error, DataError):
        for number, store in db.execute("SELECT number, store FROM last"):
            found.store, found.number = StoreMark.of(f"{store}:{number}")


class _Scan:
    """Rows of a statement, read from both ends up to the damaged part."""

    def __init__(self, db: sqlite3.Connection, statement: str) -> None:
        found: dict[tuple[Any, ...], None] = {}
        self.whole = True
        for direction in ("ASC", "DESC"):
            try:
                for row in db.execute(statement.format(direction)):
                    found[row] = None
            except sqlite3.Error:
                self.whole = False
        self.rows = list(found)


def _compare(found: Salvage, listed: Listed) -> None:
    """Name the objects with the last listed change missing from the store."""
    newest = found.newest()
    for name, change in listed.changes.items():
        record = newest.get(name)
        lost = change.number > found.number
        if change.version == 0:
            if lost:
                found.versions = [each for each in found.versions if each[0].name != name]
                found.damaged.pop(name, None)
            continue
        if record is None:
            lost = lost or found.number == listed.last
        else:
            valid_again = record.version == change.version and record.valid and not change.valid
            lost = lost or record.version < change.version or valid_again
        if lost:
            text = f"the change of its version {change.version} by transaction {change.number} is lost"
            found.damaged[name] = Damage(change.version, text)
    found.number = max(found.number, listed.last)
