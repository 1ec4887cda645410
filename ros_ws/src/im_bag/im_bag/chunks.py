"""Messages into the chunks of an MCAP file: two appends each, where the ``mcap`` package writes field by field."""

import struct
import zlib
from collections import defaultdict
from typing import Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Header, McapRecord, Schema

from im_bag.contents import MAGIC, Contents, end_of
from im_bag.files import LIBRARY

_MESSAGE = struct.Struct("<BQHIQQ")
_INDEX = struct.Struct("<BQHI")
_RECORD_HEAD = 9

#: Of zstd. Its usual level, 3, takes three times as long for a twenty-fifth less: images are most of a bag.
LEVEL = 1
_MESSAGE_FIELDS, _INDEX_FIELDS = _MESSAGE.size - _RECORD_HEAD, _INDEX.size - _RECORD_HEAD


class _File(Protocol):
    def write(self, data: bytes) -> int: ...

    def tell(self) -> int: ...


class ChunkWriter:
    """Writer of an MCAP file (https://mcap.dev/spec) with messages in compressed chunks, indexes and a summary."""

    def __init__(self, file: _File) -> None:
        self._file = file
        self._contents = Contents()
        self._compressor = zstandard.ZstdCompressor(LEVEL)
        self._chunk = bytearray()
        self._indexes: defaultdict[int, list[int]] = defaultdict(list)  # time and offset of each message, by channel
        file.write(MAGIC + _record(Header(profile="ros2", library=LIBRARY)))

    def add_channel(self, topic: str, type_name: str, encoding: str, definition: str, told: dict[str, str]) -> int:
        """Announce a topic.

        Args:
            topic: Its name.
            type_name: Its type.
            encoding: How that is defined, ``ros2msg`` or ``ros2idl``.
            definition: The definition.
            told: What else is to be known of it.

        Returns:
            The number of its channel.
        """
        number = len(self._contents.channels) + 1
        schema = Schema(id=number, data=definition.encode(), encoding=encoding, name=type_name)
        channel = Channel(id=number, topic=topic, message_encoding="cdr", schema_id=number, metadata=told)
        self._contents.schemas[number], self._contents.channels[number] = schema, channel
        self._chunk += _record(schema) + _record(channel)
        return number

    def add_message(self, channel: int, logged_ns: int, data: bytes, published_ns: int, sequence: int) -> None:
        """Append a message.

        Args:
            channel: Number of its channel.
            logged_ns: When it came [ns].
            data: The message (CDR).
            published_ns: When it left [ns].
            sequence: Its number, 32 bits.
        """
        chunk = self._chunk
        self._indexes[channel] += (logged_ns, len(chunk))
        length = _MESSAGE_FIELDS + len(data)
        chunk += _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, logged_ns, published_ns)
        chunk += data

    def end_chunk(self) -> None:
        """Write the appended messages, if there are any, as a chunk with an index."""
        if not self._indexes:
            return
        times = [time for index in self._indexes.values() for time in (min(index[::2]), max(index[::2]))]
        begin_ns, end_ns = min(times), max(times)
        raw = self._chunk
        packed = self._compressor.compress(raw)
        at = self._file.tell()
        record = _record(
            Chunk(
                compression="zstd",
                data=packed,
                message_start_time=begin_ns,
                message_end_time=end_ns,
                uncompressed_crc=zlib.crc32(raw),
                uncompressed_size=len(raw),
            )
        )
        indexes, offsets = bytearray(), {}
        contents = self._contents
        contents.begin_ns = min(contents.begin_ns, begin_ns) if contents.counts else begin_ns
        contents.end_ns = max(contents.end_ns, end_ns)
        for channel, index in self._indexes.items():
            offsets[channel] = at + len(record) + len(indexes)
            indexes += _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX_FIELDS + 8 * len(index), channel, 8 * len(index))
            indexes += struct.pack(f"<{len(index)}Q", *index)
            contents.counts[channel] += len(index) // 2
        contents.chunks.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=at,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=end_ns,
                message_index_length=len(indexes),
                message_index_offsets=offsets,
                message_start_time=begin_ns,
                uncompressed_size=len(raw),
            )
        )
        self._file.write(record)
        self._file.write(bytes(indexes))
        self._chunk = bytearray()
        self._indexes.clear()

    def finish(self) -> None:
        """Write the appended messages, and the end of the file."""
        self.end_chunk()
        self._file.write(bytes(self._chunk))  # topics without a message since: what the summary has, the data have
        self._file.write(end_of(self._contents, self._file.tell()))


def _record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
