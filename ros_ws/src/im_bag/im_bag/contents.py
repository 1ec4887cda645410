"""Contents of an MCAP file, record by record (https://mcap.dev/spec), and the matching end of the file."""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, decompress

from im_bag import unpacking
from im_core.files import MEBIBYTE, FileError

MAGIC = b"\x89MCAP0\r\n"
#: How a record begins: opcode and length of its body.
HEAD = struct.Struct("<BQ")
#: How the body of a message begins: channel, number, and times of log and publication.
MESSAGE = struct.Struct("<HIQQ")
#: A footer but for its checksum, which is also of this.
_FOOTER = struct.Struct("<BQQQ")
#: Records of the data section; any other below those of applications ends it, or is what a torn write has left.
_DATA = {
    Opcode.HEADER,
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.MESSAGE,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
}
#: From here on records are of applications, and readers pass them by.
_OF_APPLICATIONS = 0x80
_LARGEST_RECORD = 2**30

unpacking.install()


@dataclass
class Contents:
    """Contents of the data section of an MCAP file.

    Attributes:
        end: Where its last whole record ends [bytes].
        library: What wrote it, by its header.
        schemas: By number.
        channels: By number.
        counts: Messages of each channel.
        chunks: In their order.
        begin_ns: Time of the first message; 0 where there is none [ns].
        end_ns: Time of the last message [ns].
        last: Index of the messages of the last chunk, by channel: their times and offsets; empty where the file has it,
            since something else follows.
    """

    end: int = len(MAGIC)
    library: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    chunks: list[ChunkIndex] = field(default_factory=list)
    begin_ns: int = 0
    end_ns: int = 0
    last: dict[int, MessageIndex] = field(default_factory=dict)

    def add_message(self, head: bytes, offset: int) -> int:
        """Count a message, given the first bytes and the offset in the chunk; return the time of the message [ns]."""
        channel, _, logged_ns, _ = MESSAGE.unpack_from(head)
        self.begin_ns = logged_ns if not self.counts else min(self.begin_ns, logged_ns)
        self.end_ns = max(self.end_ns, logged_ns)
        self.counts[channel] += 1
        self.last.setdefault(channel, MessageIndex(channel, [])).records.append((logged_ns, offset))
        return int(logged_ns)

    def add_definition(self, opcode: int, body: bytes) -> None:
        """Keep a header, a schema or a channel."""
        if opcode == Opcode.HEADER:
            self.library = Header.read(ReadDataStream(BytesIO(body))).library
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(body)))
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(body)))
            self.channels[channel.id] = channel

    @property
    def statistics(self) -> Statistics:
        """Statistics for the summary; attachments and metadata are not counted, since our recorders write none."""
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=self.counts.total(),
            message_end_time=self.end_ns,
            message_start_time=self.begin_ns,
            metadata_count=0,
            schema_count=len(self.schemas),
        )


def scan(path: Path, file: BinaryIO) -> Contents:
    """Read an MCAP file record by record, as far as the records are whole.

    A chunk that is damaged is left out, with what belongs to it; where whole ones follow, the file goes on to these.

    Raises:
        FileError: It is no MCAP file, or holds what is not read here, though it may be whole.
    """
    if file.read(len(MAGIC)) != MAGIC:
        raise FileError(path, "is no MCAP file")
    contents, whole, indexed = Contents(), True, False
    for opcode, offset, length in _records(path, file, os.fstat(file.fileno()).st_size):
        if opcode not in _DATA and opcode < _OF_APPLICATIONS:
            break
        body = file.read(length)
        if opcode == Opcode.CHUNK:
            unpacked = _unpacked(path, body, offset)
            whole = unpacked is not None
            indexed = unpacked is not None and _add_chunk(contents, *unpacked, offset, length)
        elif opcode == Opcode.MESSAGE_INDEX:
            if indexed:
                _add_index(contents, body, offset)
        elif opcode == Opcode.MESSAGE:
            contents.add_message(body, offset)
        else:
            contents.add_definition(opcode, body)
        if whole:
            contents.end = offset + HEAD.size + length
            indexed = indexed and opcode in (Opcode.CHUNK, Opcode.MESSAGE_INDEX)
    if contents.chunks and indexed:  # its index is written again: nothing tells whether it is whole
        last = contents.chunks[-1]
        contents.end = last.chunk_start_offset + last.chunk_length
    elif contents.chunks:
        contents.last = {}
    return contents


def _records(path: Path, file: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length of the body of each whole record; the file stands at the body.

    Raises:
        FileError: One is whole, and larger than what is read.
    """
    offset = len(MAGIC)
    while offset + HEAD.size <= size:
        file.seek(offset)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        if offset + HEAD.size + length > size:
            return
        if length > _LARGEST_RECORD:
            told, most = length // MEBIBYTE, _LARGEST_RECORD // MEBIBYTE
            raise FileError(
                path, f"cannot be read: its record at byte {offset} has {told} MiB; at most {most} are read"
            )
        yield opcode, offset, length
        offset += HEAD.size + length


def _unpacked(path: Path, body: bytes, offset: int) -> tuple[Chunk, bytes] | None:
    """Return a chunk and the unpacked content; None if the chunk is damaged.

    Raises:
        FileError: It is compressed in a way that is not known here, or larger than what is unpacked.
    """
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        _check_readable(path, chunk, offset)
        return chunk, decompress(chunk.data, chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc)
    except (FileError, MemoryError):
        raise
    except Exception:  # what unpacks bytes that were cut or spoilt raises errors of any name
        return None


def _add_chunk(contents: Contents, chunk: Chunk, raw: bytes, offset: int, length: int) -> bool:
    """Add a chunk with all content; return False if the channels were defined in a damaged chunk."""
    held = list(_held(raw))
    known = contents.channels.keys() | {_number(raw, start) for opcode, _, start, _ in held if opcode == Opcode.CHANNEL}
    if any(opcode == Opcode.MESSAGE and _number(raw, start) not in known for opcode, _, start, _ in held):
        return False
    contents.last = {}
    for opcode, at, start, end in held:
        if opcode == Opcode.MESSAGE:
            contents.add_message(raw[start : start + MESSAGE.size], at)
        else:
            contents.add_definition(opcode, raw[start:end])
    contents.chunks.append(
        ChunkIndex(
            chunk_length=HEAD.size + length,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
    )
    return True


def _check_readable(path: Path, chunk: Chunk, offset: int) -> None:
    where = f"cannot be read: its chunk at byte {offset}"
    if chunk.compression not in DECOMPRESSORS:
        known = ", ".join(repr(name) for name in DECOMPRESSORS)
        raise FileError(path, f"{where} is compressed as {chunk.compression!r}; known are {known}")
    if chunk.uncompressed_size > unpacking.LARGEST_PIECE:
        size, most = (size / MEBIBYTE for size in (chunk.uncompressed_size, unpacking.LARGEST_PIECE))
        raise FileError(path, f"{where} unpacks to {size:.0f} MiB; at most {most:g} MiB are read")


def _held(raw: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Yield opcode and offset of each record of a chunk, and begin and end of the record's body."""
    at = 0
    while at + HEAD.size <= len(raw):
        opcode, length = HEAD.unpack_from(raw, at)
        start = at + HEAD.size
        yield opcode, at, start, start + length
        at = start + length


def _number(raw: bytes, start: int) -> int:
    """Return the channel number of a record: of the defined channel, or of the message's channel."""
    return int.from_bytes(raw[start : start + 2], "little")


def _add_index(contents: Contents, body: bytes, offset: int) -> None:
    if contents.chunks:
        chunk = contents.chunks[-1]
        chunk.message_index_offsets[int.from_bytes(body[:2], "little")] = offset
        chunk.message_index_length += HEAD.size + len(body)


def last_index(contents: Contents) -> bytes:
    """Return the missing index of the last chunk, as bytes; the chunk ends at the end of the data."""
    builder = RecordBuilder()
    if contents.chunks and contents.last:
        chunk = contents.chunks[-1]
        chunk.message_index_offsets = {}
        for channel, index in contents.last.items():
            chunk.message_index_offsets[channel] = contents.end + builder.count
            index.write(builder)
        chunk.message_index_length = builder.count
    return bytes(builder.end())


def end_of(contents: Contents, at: int) -> bytes:
    """Return the bytes behind the data: end of the data, summary and footer.

    Args:
        contents: What the data hold.
        at: Where they end [bytes].
    """
    builder = RecordBuilder()
    DataEnd(0).write(builder)
    data_end = bytes(builder.end())
    start = at + len(data_end)
    groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
        (Opcode.SCHEMA, list(contents.schemas.values())),
        (Opcode.CHANNEL, list(contents.channels.values())),
        (Opcode.STATISTICS, [contents.statistics]),
        (Opcode.CHUNK_INDEX, contents.chunks),
    ]
    offsets = []
    for opcode, records in groups:
        begin = start + builder.count
        for record in records:
            record.write(builder)
        offsets.append(SummaryOffset(opcode, begin, start + builder.count - begin))
    offset_start = start + builder.count
    for summary_offset in offsets:
        if summary_offset.group_length:
            summary_offset.write(builder)
    summary = bytes(builder.end())
    crc = zlib.crc32(summary + _FOOTER.pack(Opcode.FOOTER, _FOOTER.size + 4 - HEAD.size, start, offset_start))
    Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc).write(builder)
    return data_end + summary + bytes(builder.end()) + MAGIC
