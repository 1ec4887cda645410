"""The MCAP files of a bag: what they hold, told in ``metadata.yaml``; a recording that was cut short is completed."""

import fcntl
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
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
from mcap.summary import Summary
from rosbags.rosbag2.storage_mcap import decompress

from im_core import clock, unpacking
from im_core.errors import StoreError
from im_core.files import MEBIBYTE, FileError, check_regular, read_text, write_whole
from im_core.yamltext import YamlError, as_data, read_yaml, write_yaml

METADATA = "metadata.yaml"
LARGEST_METADATA = 16 * MEBIBYTE

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
#: What the header of a file names whose recorder locks it (im_bringup/bag/writer.py).
LIBRARY = "im"
#: A file of another recorder, which takes no lock, may still be written while its last bytes are no older [s].
_SETTLED_S = 5.0
#: By how much parts of one bag may overlap: a recorder takes what waits in its queues, one after the other [ns].
_OVERLAP_NS = 2 * 10**9
_RECORDED = "is being recorded; end the recording first"

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


def complete_bag(bag: Path) -> None:
    """Complete what a recorder that was killed has left: files without an end, and a folder without metadata.

    A file that a recorder is writing is left alone; the bag is then what was complete before it.

    Args:
        bag: Folder of a bag, or a file of it; one whose metadata name all its MCAP files is not looked at further.

    Raises:
        DataError: It cannot be completed: it is being recorded, has no message, is no MCAP file, was complete once
            and is cut now, lacks a file that its metadata list, or has one that does not belong to it.
    """
    if not bag.is_dir():
        if bag.suffix == ".mcap" and not _has_end(bag):
            complete_file(bag)
        return
    described = (bag / METADATA).exists()
    listed = _listed_files(bag / METADATA) if described else []
    files = sorted(bag.glob("*.mcap"))
    for path in files:
        if path.name in listed and _is_cut(path):
            text = "lacks its end, as a copy that was broken off; copy it again, or remove"
            raise FileError(path, f"{text} {METADATA} beside it: what is whole of it is then taken as the bag")
    if not (new := [path for path in files if path.name not in listed]):
        return
    busy = [path for path in new if is_recorded(path)]
    if described and busy:
        return
    if busy:
        raise FileError(bag, _RECORDED)
    contents = _contents(files)
    _check_belonging(bag, listed, contents)
    for path in new:
        if path in contents and not _has_end(path):
            complete_file(path)
    _describe(bag, contents)


def parts(bag: Path) -> list[Path]:
    """The MCAP files in the folder of a bag, in the order of their first messages; without those that are empty."""
    return list(_contents(bag.glob("*.mcap")))


def _contents(files: Iterable[Path]) -> dict[Path, Contents]:
    """What files hold, in the order of their first messages, whatever their names; empty ones are left out."""
    found = {}
    for path in files:
        if path.stat().st_size:
            with path.open("rb") as file:
                found[path] = _summary(path) if _has_end(path) else scan(path, file)
    return dict(sorted(found.items(), key=lambda item: (not item[1].counts, item[1].begin_ns, item[0].name)))


def _check_belonging(bag: Path, listed: Sequence[str], contents: Mapping[Path, Contents]) -> None:
    """Refuse what a recorder that was killed cannot have left: a copy of a part, a file of another bag, a gap.

    Raises:
        FileError: A listed file is missing, or one that is not listed does not belong to the bag.
    """
    if missing := [name for name in listed if not (bag / name).exists()]:
        text = f"lacks {', '.join(missing)}, which {METADATA} lists; put it back, or remove {METADATA}"
        raise FileError(bag, f"{text}: what is there is then taken as the bag")
    new = sorted(
        (path for path, held in contents.items() if path.name not in listed and held.counts),
        key=lambda path: (contents[path].begin_ns, len(path.name), path.name),
    )
    if new and any(not name.endswith(".mcap") for name in listed):
        raise FileError(new[0], f"does not belong to this bag, which is in other files by its {METADATA}; move it away")
    taken = [path for path in contents if path.name in listed]
    for path in new:
        for other in taken:
            if _is_of_the_same_time(contents[path], contents[other]):
                text = f"it is of the same time as {other.name}, as a copy or another bag is: move it away"
                raise FileError(path, f"does not belong to this bag; {text}")
        taken.append(path)


def _is_of_the_same_time(one: Contents, other: Contents) -> bool:
    overlap_ns = min(one.end_ns, other.end_ns) - max(one.begin_ns, other.begin_ns)
    return bool(other.counts) and (one.begin_ns == other.begin_ns or overlap_ns > _OVERLAP_NS)


def is_recorded(path: Path) -> bool:
    """Whether a recorder has this file open."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False


def complete_file(path: Path) -> None:
    """Cut a file after its last whole record, and append the summary and the end that it lacks.

    Args:
        path: An MCAP file.

    Raises:
        DataError: It is no MCAP file, or it is being recorded, as far as can be told.
        StoreError: It cannot be written.
    """
    try:
        with path.open("r+b") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise FileError(path, _RECORDED) from None
            size = os.fstat(file.fileno()).st_size
            contents = scan(path, file)
            if contents.library != LIBRARY:
                _check_settled(path, os.fstat(file.fileno()), size)
            file.truncate(contents.end)
            file.seek(contents.end)
            index = _last_index(contents)
            file.write(index + end_of(contents, contents.end + len(index)))
    except OSError as error:
        raise StoreError.of("completed", path, error) from error


def _check_settled(path: Path, status: os.stat_result, size: int) -> None:
    """Refuse a file that grows, or to which bytes came just now: its recorder may go on."""
    if status.st_size != size:
        raise FileError(path, _RECORDED)
    if abs(clock.wall() - status.st_mtime) < _SETTLED_S:
        text = f"lacks its end and was written less than {_SETTLED_S:g} s ago, perhaps by a recorder that goes on"
        raise FileError(path, f"{text}; end the recording, or try again in {_SETTLED_S:g} s")


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


def write_metadata(bag: Path, files: Sequence[Path]) -> None:
    """Write ``metadata.yaml`` of a bag from the summaries of its files.

    Args:
        bag: Folder of the bag.
        files: Complete MCAP files in it, in their order.

    Raises:
        DataError: There is none, or one is no MCAP file.
        StoreError: It cannot be written.
    """
    _describe(bag, {path: _summary(path) for path in files})


def _describe(bag: Path, contents: Mapping[Path, Contents]) -> None:
    """Write ``metadata.yaml``; exceptions as of :func:`write_metadata`."""
    if not contents:
        raise FileError(bag, "has no message: the recording ended before the first was written")
    content = {"rosbag2_bagfile_information": _described(list(contents.items()))}
    write_whole(bag / METADATA, write_yaml(content))


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


def _last_index(contents: Contents) -> bytes:
    """The index of the last chunk, which ends where the data do."""
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


def _has_end(path: Path) -> bool:
    check_regular(path, path.stat())
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) < 2 * len(MAGIC):
            return False
        file.seek(-len(MAGIC), os.SEEK_END)
        return file.read() == MAGIC


def _is_cut(path: Path) -> bool:
    """Whether it is an MCAP file as far as it goes."""
    if _has_end(path):
        return False
    with path.open("rb") as file:
        return MAGIC.startswith(file.read(len(MAGIC)))


def _summary(path: Path) -> Contents:
    """What the summary of a complete file says, or the file itself where that does not tell all channels and types."""
    with path.open("rb") as file:
        try:
            summary = make_reader(file).get_summary()
        except Exception as error:  # of any name, as above
            raise FileError(path, f"cannot be read: {error or type(error).__name__}") from error
        if summary is None or (told := summary.statistics) is None or not _is_told(summary, told):
            file.seek(0)
            return scan(path, file)
        return Contents(
            schemas=summary.schemas,
            channels=summary.channels,
            counts=Counter(told.channel_message_counts),
            begin_ns=told.message_start_time,
            end_ns=told.message_end_time,
        )


def _is_told(summary: Summary, told: Statistics) -> bool:
    defined = {number for number, channel in summary.channels.items() if channel.schema_id in summary.schemas}
    counts = told.channel_message_counts
    return sum(counts.values()) == told.message_count and counts.keys() <= defined


def _listed_files(metadata: Path) -> list[str]:
    try:
        content: Any = as_data(read_yaml(read_text(metadata, LARGEST_METADATA), str(metadata)))
        return [Path(name).name for name in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except YamlError as error:
        raise FileError(metadata, error.sentence, error.place.line) from error
    except (LookupError, TypeError) as error:
        raise FileError(metadata, "cannot be read: it says nothing of the files of a bag") from error


def _described(files: Sequence[tuple[Path, Contents]]) -> dict[str, Any]:
    filled = [contents for _, contents in files if contents.counts]
    begin = min((contents.begin_ns for contents in filled), default=0)
    end = max((contents.end_ns for contents in filled), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": [path.name for path, _ in files],
        "duration": {"nanoseconds": end - begin},
        "starting_time": {"nanoseconds_since_epoch": begin},
        "message_count": sum(contents.counts.total() for _, contents in files),
        "topics_with_message_count": _topics([contents for _, contents in files]),
        "compression_format": "",
        "compression_mode": "",
        "files": [
            {
                "path": path.name,
                "starting_time": {"nanoseconds_since_epoch": contents.begin_ns},
                "duration": {"nanoseconds": contents.end_ns - contents.begin_ns},
                "message_count": contents.counts.total(),
            }
            for path, contents in files
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _topics(files: Sequence[Contents]) -> list[dict[str, Any]]:
    """Each topic, once for each type and each hash of it that it has."""
    counts: Counter[tuple[str, str, str]] = Counter()
    told: dict[tuple[str, str, str], dict[str, Any]] = {}
    for contents in files:
        for channel in contents.channels.values():
            schema = contents.schemas.get(channel.schema_id)
            type_name = schema.name if schema else ""
            key = channel.topic, type_name, channel.metadata.get("topic_type_hash", "")
            counts[key] += contents.counts[channel.id]
            told[key] = {
                "name": channel.topic,
                "type": type_name,
                "serialization_format": channel.message_encoding,
                "offered_qos_profiles": yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or [],
                "type_description_hash": key[2],
            }
    return [{"topic_metadata": told[key], "message_count": counts[key]} for key in told]
