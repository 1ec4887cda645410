"""Readers for complete bag files: also files without an index, and SQLite files with a log beside the file.

Of MCAP files it finds channels in the summary only, and passes by chunks whose messages have no index; both may be left
out of a file that is whole (https://mcap.dev/spec, "Summary Section", "Message Index"). Hashes it takes from
``metadata.yaml``. Of SQLite files it passes by the log in which the last messages of a killed recorder are.
"""

import shutil
import sqlite3
from collections.abc import Collection, Container, Generator, Iterator, Mapping
from contextlib import closing
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import MAXSIZE, McapReader, read_exact, read_string
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from im_bag.contents import HEAD, MESSAGE

#: Type of a channel whose definition is not in the summary.
_UNDEFINED = "__schemaless__"
_PLACE = np.dtype([("channel", "u2"), ("logged_ns", "u8"), ("offset", "u8"), ("size", "u8")])
#: What SQLite keeps beside a file that is written: a log of what is new, or of what was there before.
_LOGS = ("-wal", "-journal")
#: How messages of ROS 2 are serialised.
_SERIALIZED = "cdr"


class WholeMcapReader(McapReader):
    """Reader of every message of a file, even with an incomplete index, and of the type hashes in the channels."""

    def open(self) -> None:
        """Open the file.

        Raises:
            ReaderError: It is damaged, or holds messages or definitions of types that are not those of ROS 2.
        """
        try:
            super().open()
        except KeyError as error:  # of a table of the ways to define a type
            known = "of ROS 2 are ros2msg and ros2idl"
            raise ReaderError(f"Type definition format {error} is not supported: {known}.") from error
        foreign = {each.message_encoding for each in self.channels.values()} - {_SERIALIZED}
        if foreign:
            self.close()
            raise ReaderError(f"Serialization format {foreign!r} is not supported.")  # as of a folder
        self.connections = [
            each._replace(digest=_hash(_told(self.channels[each.id].metadata).get("topic_type_hash", "")))
            for each in self.connections
        ]

    def read_index(self) -> None:
        """Read the summary; read the whole file if the summary is incomplete."""
        super().read_index()
        if self.statistics is not None and len(self.chunks) != self.statistics.chunk_count:
            self.chunks.clear()  # so that the file is read from its beginning
        if not self._is_told():
            for found in (self.schemas, self.channels, self.connections):
                found.clear()
            self.meta_scan()
        for chunk in self.chunks:
            if not chunk.message_index_offsets:
                chunk.channel_count.update(dict.fromkeys(self.channels, 1))  # each may be in it

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield messages in order of time, also messages stored one by one, without chunks, in another order.

        Args:
            connections: Whose.
            start: From when on [ns].
            stop: Before when [ns].
        """
        if self.chunks or (self.statistics is not None and self.statistics.chunk_count):
            yield from super().messages(connections, start, stop)
            return
        assert self.bio is not None
        of = {each.id: each for each in connections}
        places = np.fromiter(self._places(of, start, stop), dtype=_PLACE)
        for channel, logged_ns, offset, size in places[np.argsort(places["logged_ns"], kind="stable")].tolist():
            self.bio.seek(offset)
            yield of[channel], logged_ns, read_exact(self.bio, size)

    def _places(
        self, wanted: Container[int], start: int | None, stop: int | None
    ) -> Iterator[tuple[int, int, int, int]]:
        """Yield channel, time, offset and data size of each wanted message; see ``messages``."""
        assert self.bio is not None
        at = self.data_start
        while at < self.data_end:
            self.bio.seek(at)
            opcode, length = HEAD.unpack(read_exact(self.bio, HEAD.size))
            if opcode == Opcode.MESSAGE:
                channel, _, logged_ns, _ = MESSAGE.unpack(read_exact(self.bio, MESSAGE.size))
                if channel in wanted and (start or 0) <= logged_ns < (MAXSIZE if stop is None else stop):
                    yield channel, logged_ns, self.bio.tell(), length - MESSAGE.size
            at += HEAD.size + length

    def _is_told(self) -> bool:
        """Whether the summary names the channel and the type of every message."""
        if any(channel.schema == _UNDEFINED for channel in self.channels.values()):
            return False
        if self.statistics is None:
            return all(chunk.message_index_offsets for chunk in self.chunks)
        counts = self.statistics.channel_message_counts
        return sum(counts.values()) == self.statistics.message_count and counts.keys() <= self.channels.keys()


class WholeSqliteReader(Sqlite3Reader):
    """Reader of a SQLite file together with the log left beside the file by a killed recorder."""

    _copy: TemporaryDirectory[str] | None = None

    def open(self) -> None:
        """Open the file; if a log lies beside the file, open a copy of both after SQLite has merged the log.

        Raises:
            ReaderError: The file is damaged, or there is no room for the copy.
        """
        file = Path(str(self.path))
        logs = [log for end in _LOGS if (log := file.with_name(f"{file.name}{end}")).exists()]
        if any(log.stat().st_size for log in logs):
            self._copy = TemporaryDirectory(prefix="im_bag_")
            try:
                for path in (file, *logs):
                    shutil.copyfile(path, Path(self._copy.name) / path.name)
                self.path = copy = Path(self._copy.name) / file.name
                with closing(sqlite3.connect(copy)) as db:
                    db.execute("PRAGMA journal_mode=DELETE")
            except (OSError, sqlite3.Error) as error:
                self._copy.cleanup()
                names = " and ".join(log.name for log in logs)
                raise ReaderError(f"The bag cannot be completed from {names}, left by its recorder: {error}") from error
        super().open()

    def close(self) -> None:
        """Close the file."""
        super().close()
        if self._copy is not None:
            self._copy.cleanup()


def _by_ending(path: Path) -> Any:
    """Return the reader of a bag file by the file name's ending, for metadata without the kind of the files."""
    if path.suffix not in _BY_ENDING:
        raise ReaderError(f"{path.name} is no file of a bag: {', '.join(_BY_ENDING)}")
    return _BY_ENDING[path.suffix](path)


_BY_ENDING: Mapping[str, Any] = {".mcap": WholeMcapReader, ".db3": WholeSqliteReader}


class _WholeDirectoryReader(DirectoryReader):
    STORAGE_PLUGINS: Mapping[str, Any] = {"mcap": WholeMcapReader, "sqlite3": WholeSqliteReader, "": _by_ending}

    def open(self) -> None:
        """Open the bag with the types found in the files: metadata may name only one of several types of a topic."""
        super().open()
        self.connections = [each._replace(digest=_hash(each.digest)) for each in self.connections]
        for each in (each for storage in self.storages for each in storage.connections):
            for number, known in enumerate(self.connections):
                if _is_same(each, known):
                    self.connections[number] = known._replace(digest=known.digest or _hash(each.digest))
                    break
            else:
                self.connections.append(each._replace(id=len(self.connections) + 1, owner=self))


class WholeReader(Reader):
    """Reader of bags, folders and files, with every contained message."""

    STORAGE_PLUGINS: Mapping[str, Any] = {
        "dir": _WholeDirectoryReader,
        **_BY_ENDING,
    }


def _is_same(stored: Connection, listed: Connection) -> bool:
    """Check whether a file's connection is presented as a given connection of the metadata."""
    told = (listed.topic, listed.msgtype, listed.ext) == (stored.topic, stored.msgtype, stored.ext)
    return told and (not listed.digest or not stored.digest or listed.digest == stored.digest)


def _hash(text: str) -> str:
    """Return the hash of a type; empty for the placeholder of a publisher without a hash (``INVALID``)."""
    return text if text.startswith("RIHS") else ""


def _told(metadata: bytes) -> dict[str, str]:
    """Return the metadata of a channel beside the topic: texts, each after a name."""
    stream, told = BytesIO(metadata), {}
    while stream.tell() < len(metadata):
        name = read_string(stream)
        told[name] = read_string(stream)
    return told
