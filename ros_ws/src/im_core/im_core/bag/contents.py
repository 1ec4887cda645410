"""What an MCAP file holds, record by record (https://mcap.dev/spec), and the end that belongs to it."""

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
from rosbags.rosbag2.storage_mcap import decompress

from im_core.bag import unpacking
from im_core.files import FileError

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
#: A footer but for its checksum, which is also of this.
_FOOTER = struct.Struct("<BQQQ")
#: Records of the data section; any other ends it, or is what a torn write has left.
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
_LARGEST_RECORD = 2**30

unpacking.install()


@dataclass
class Contents:
    """What the data section of an MCAP file holds.

    Attributes:
        end: Where its last whole record ends [bytes].
        library: What wrote it, by its header.
        schemas: By number.
        channels: By number.
        counts: Messages of each channel.
        chunks: In their order.
        begin_ns: Time of the first message; 0 where there is none [ns].
        end_ns: Time of the last message [ns].
        last: Index of the messages of the last chunk, by channel: their times and offsets.
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
        """Count a message, from its first bytes and its place in its chunk; its time [ns]."""
        channel, _, logged_ns, _ = _MESSAGE.unpack_from(head)
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
        """As the summary has them; attachments and metadata, which no recorder of ours writes, are not counted."""
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
    """Read an MCAP file record by record, as far as they are whole.

    Raises:
        FileError: It is no MCAP file.
    """
    if file.read(len(MAGIC)) != MAGIC:
        raise FileError(path, "is no MCAP file")
    contents = Contents()
    for opcode, offset, length in _records(file, os.fstat(file.fileno()).st_size):
        if opcode not in _DATA:
            break
        body = file.read(length)
        if opcode == Opcode.CHUNK:
            if not _add_chunk(contents, body, offset):
                break
        elif opcode == Opcode.MESSAGE_INDEX:
            _add_index(contents, body, offset)
        elif opcode == Opcode.MESSAGE:
            contents.add_message(body, offset)
        else:
            contents.add_definition(opcode, body)
        contents.end = offset + _HEAD.size + length
    if contents.chunks:  # its index is written again: nothing tells whether it is whole
        last = contents.chunks[-1]
        contents.end = last.chunk_start_offset + last.chunk_length
    return contents


def _records(file: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length of the body of each whole record; the file stands at the body."""
    offset = len(MAGIC)
    while offset + _HEAD.size <= size:
        file.seek(offset)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        if offset + _HEAD.size + length > size or length > _LARGEST_RECORD:
            return
        yield opcode, offset, length
        offset += _HEAD.size + length


def _add_chunk(contents: Contents, body: bytes, offset: int) -> bool:
    """Add a chunk with what is in it; False if it is damaged."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        raw = decompress(chunk.data, chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc)
    except Exception:  # what unpacks bytes that were cut or spoilt raises errors of any name
        return False
    contents.last = {}
    at = 0
    while at + _HEAD.size <= len(raw):
        opcode, length = _HEAD.unpack_from(raw, at)
        start = at + _HEAD.size
        if opcode == Opcode.MESSAGE:
            contents.add_message(raw[start : start + _MESSAGE.size], at)
        else:
            contents.add_definition(opcode, raw[start : start + length])
        at = start + length
    contents.chunks.append(
        ChunkIndex(
            chunk_length=_HEAD.size + len(body),
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


def _add_index(contents: Contents, body: bytes, offset: int) -> None:
    if contents.chunks:
        chunk = contents.chunks[-1]
        chunk.message_index_offsets[int.from_bytes(body[:2], "little")] = offset
        chunk.message_index_length += _HEAD.size + len(body)


def last_index(contents: Contents) -> bytes:
    """The index of the last chunk, as bytes; the chunk ends where the data do, and its index follows."""
    builder = RecordBuilder()
    if contents.chunks:
        chunk = contents.chunks[-1]
        chunk.message_index_offsets = {}
        for channel, index in contents.last.items():
            chunk.message_index_offsets[channel] = contents.end + builder.count
            index.write(builder)
        chunk.message_index_length = builder.count
    return bytes(builder.end())


def end_of(contents: Contents, at: int) -> bytes:
    """What follows the data: their end, the summary and the footer.

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
    crc = zlib.crc32(summary + _FOOTER.pack(Opcode.FOOTER, _FOOTER.size + 4 - _HEAD.size, start, offset_start))
    Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc).write(builder)
    return data_end + summary + bytes(builder.end()) + MAGIC
