"""The tables of the object store, and the checksums of the rows."""

import zlib
from typing import Any

from im_dom.object_record import ObjectRecord

SCHEMA_VERSION = 6

PAGE = 4096
"""Size of a page of the file [byte]."""

SCHEMA = f"""
PRAGMA page_size = {PAGE};
BEGIN;
CREATE TABLE versions (
    name TEXT NOT NULL, version INTEGER NOT NULL, type TEXT NOT NULL, hash TEXT NOT NULL, valid INTEGER NOT NULL,
    place TEXT NOT NULL, source TEXT NOT NULL, command TEXT NOT NULL, stamp_ns INTEGER NOT NULL, size INTEGER NOT NULL,
    data_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (name, version)
) STRICT;
CREATE TABLE appended (
    name TEXT NOT NULL, request TEXT NOT NULL, version INTEGER NOT NULL, checksum INTEGER NOT NULL
) STRICT;
CREATE INDEX appended_request ON appended (name, request);
CREATE TABLE damaged (name TEXT PRIMARY KEY, version INTEGER NOT NULL, why TEXT NOT NULL) STRICT;
CREATE TABLE last (number INTEGER NOT NULL, store TEXT NOT NULL) STRICT;
INSERT INTO last VALUES (0, lower(hex(randomblob(8))));
PRAGMA user_version = {SCHEMA_VERSION};
COMMIT;
"""

COLUMNS = "name, version, type, hash, valid, place, source, command, stamp_ns, size, data_checksum, checksum"
"""Of what is known of a version; its data follow."""


def row_of(record: ObjectRecord, data: bytes) -> tuple[object, ...]:
    """Return the row of a version: :data:`COLUMNS`, and the data."""
    return (
        record.name,
        record.version,
        record.type,
        record.hash,
        record.valid,
        record.place,
        record.source,
        record.command,
        record.stamp_ns,
        record.size,
        record.data_checksum,
        record.checksum(),
        data,
    )


def record_of(row: tuple[Any, ...]) -> tuple[ObjectRecord, bool]:
    """Return the version described by a row, and whether the row is intact.

    Args:
        row: :data:`COLUMNS`; the data may follow.
    """
    name, version, kind, kind_hash, valid, place, source, command, stamp_ns, size, data_checksum, checksum = row[:12]
    record = ObjectRecord(
        name, version, kind, kind_hash, bool(valid), place, source, command, stamp_ns, size, data_checksum
    )
    whole = valid in (0, 1) and record.checksum() == checksum and all(map(record.fits, row[12:]))
    return record, whole


def request_checksum(name: str, request: str, version: int) -> int:
    """Return the checksum of a remembered append request (CRC-32)."""
    return zlib.crc32(repr((name, request, version)).encode())
