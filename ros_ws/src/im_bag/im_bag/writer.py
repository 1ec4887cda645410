"""Writer of bags: MCAP in chunks, each on the disk when flushed; messages are the bytes of the middleware."""

import fcntl
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from im_bag.chunks import ChunkWriter
from im_bag.definitions import Definition, full_definition
from im_bag.delivery import Delivery
from im_bag.files import complete_file, write_metadata
from im_core.errors import DataError, StoreError
from im_core.text.yamltext import write_yaml

#: Size of messages after which a chunk is written although nobody asked [bytes].
_CHUNK = 2**20


@dataclass(frozen=True)
class PartLimits:
    """Limits of the parts of a bag.

    Attributes:
        size_bytes: Size of messages after which the next part begins [bytes].
        time_ns: Time after which the next part begins [ns].
        free_bytes: The recording ends before less of the disk is free [bytes].
    """

    size_bytes: int = 256 * 2**20
    time_ns: int = 300 * 10**9
    free_bytes: int = 64 * 2**20


class _PartFile:
    """File of a part, locked while open; an incomplete write leaves no trace in the file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._file, fcntl.LOCK_EX)
        self._waiting = bytearray()
        self._written = 0

    def write(self, data: bytes) -> int:
        """Take some bytes, to be written at the next flush of the file."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._written + len(self._waiting)

    def flush(self) -> None:
        """Write the bytes taken so far.

        Raises:
            OSError: Not all of it can be; none of it is.
        """
        done = 0
        try:
            while done < len(self._waiting):
                done += os.write(self._file, memoryview(self._waiting)[done:])
        except OSError:
            os.ftruncate(self._file, self._written)
            os.lseek(self._file, self._written, os.SEEK_SET)
            raise
        self._written += done
        self._waiting = bytearray()

    def is_empty(self) -> bool:
        """Check whether no byte of the file has reached the disk."""
        return not self._written

    def close(self) -> None:
        """Close the file; bytes not flushed are lost."""
        os.close(self._file)


class BagWriter:
    """Writer of a bag in parts: each part is a complete file before the next one begins.

    A recorder that is killed loses what it has not flushed; readers complete its last part
    (:func:`im_bag.files.complete_bag`).

    Args:
        path: Folder of the bag; it must not exist.
        limits: When the next part begins, and how much of the disk is left alone.

    Raises:
        DataError: It exists, or cannot be made.
    """

    def __init__(self, path: Path, limits: PartLimits | None = None) -> None:
        self.path = path
        self.counts: dict[str, int] = {}
        self._limits = limits or PartLimits()
        self._topics: dict[str, tuple[str, Definition, Delivery, str]] = {}
        self._parts: list[Path] = []
        self._channels: dict[str, int] = {}
        self._size, self._flushed, self._begun_ns = 0, 0, 0
        self._last_ns = 0
        self._broken: StoreError | None = None
        try:
            path.mkdir(parents=True)
            self._begin_part()
        except OSError as error:
            raise DataError(f"the bag {path} cannot be made: {error.strerror}", path=str(path)) from error

    def add_topic(self, topic: str, type_name: str, delivery: Delivery, type_hash: str = "") -> None:
        """Announce a topic.

        Args:
            topic: Its name.
            type_name: E.g. ``im_msgs/msg/Firing``.
            delivery: How its publishers offer it.
            type_hash: Hash of its type, as ROS tells it.

        Raises:
            DataError: Its type is not defined in any sourced workspace.
        """
        self._topics[topic] = type_name, full_definition(type_name), delivery, type_hash
        self.counts[topic] = 0
        self._connect(topic)

    def write(
        self, topic: str, logged_ns: int, data: bytes, published_ns: int | None = None, sequence: int = 0
    ) -> None:
        """Append a message.

        Args:
            topic: An announced topic.
            logged_ns: When it came, wall time; what comes after the clock was set back counts as come with the message
                before it, since readers go by these times [ns].
            data: The message, serialised (CDR).
            published_ns: When it left, by the clock of its source [ns]; None: not known.
            sequence: Its number, counted by its publisher; 0: not known.

        Raises:
            StoreError: The disk is full, or nearly so; :meth:`close` keeps what was written before.
        """
        self._last_ns = logged_ns = max(logged_ns, self._last_ns)
        self._begun_ns = self._begun_ns or logged_ns
        published_ns = logged_ns if published_ns is None else published_ns
        if self._broken is not None:
            raise self._broken
        self._writer.add_message(self._channels[topic], logged_ns, data, published_ns, sequence & 0xFFFF_FFFF)
        self.counts[topic] += 1
        self._size += len(data)
        if self._size >= self._flushed + _CHUNK:
            self.flush()
        if self._size >= self._limits.size_bytes or logged_ns - self._begun_ns >= self._limits.time_ns:
            self._end_part()
            self._attempt(self._begin_part)

    def flush(self) -> None:
        """Write the appended messages as a chunk; from now on the chunk outlives the process.

        Raises:
            StoreError: As of :meth:`write`.
        """
        self._flushed = self._size
        self._attempt(self._write_chunk)
        free = self._attempt(lambda: shutil.disk_usage(self.path).free)
        if free < self._limits.free_bytes:
            kept = self._limits.free_bytes / 2**20
            reason = f"{free / 2**20:.0f} MiB are free on the disk, and {kept:.0f} stay free"
            raise StoreError(f"{self.path} is not written any longer: {reason}", file=str(self.path), reason=reason)

    def close(self) -> None:
        """Finish the bag.

        Raises:
            StoreError: Its end cannot be written; what was flushed is kept, and readers complete it.
        """
        if self._broken is None:
            self._end_part()
            return
        if self._file.path in self._parts:
            return  # the next could not be begun
        try:
            self._file.close()
            if not self._file.is_empty():
                complete_file(self._file.path)
                write_metadata(self.path, [*self._parts, self._file.path])
            elif self._parts:  # they are listed; without, the empty file tells why there is no message
                self._file.path.unlink(missing_ok=True)
        except OSError as error:
            raise StoreError.of("completed", self.path, error) from error

    def _attempt(self, act: Callable[[], Any]) -> Any:
        """Run an operation on the disk; a failure (for example a full disk) fails all later operations, too."""
        if self._broken is not None:
            raise self._broken
        try:
            return act()
        except OSError as error:
            self._broken = StoreError.of("written", self.path, error)
            raise self._broken from error

    def _begin_part(self) -> None:
        name = f"{self.path.name}_{len(self._parts)}.mcap" if self._parts else f"{self.path.name}.mcap"
        self._file = _PartFile(self.path / name)
        self._writer = ChunkWriter(self._file)
        self._size, self._flushed, self._begun_ns = 0, 0, 0
        for topic in self._topics:
            self._connect(topic)

    def _connect(self, topic: str) -> None:
        type_name, definition, delivery, type_hash = self._topics[topic]
        told = {"offered_qos_profiles": _profiles(delivery), "topic_type_hash": type_hash}
        self._channels[topic] = self._writer.add_channel(topic, type_name, definition.encoding, definition.text, told)

    def _write_chunk(self) -> None:
        self._writer.end_chunk()
        self._file.flush()

    def _end_part(self) -> None:
        """Finish the current file, and list the file."""

        def finish() -> None:
            self._writer.finish()
            self._file.flush()
            write_metadata(self.path, [*self._parts, self._file.path])

        self._attempt(finish)
        self._parts.append(self._file.path)
        self._attempt(self._file.close)


@cache
def _profiles(delivery: Delivery) -> str:
    """Return the QoS profile as written in channels; cached: many topics in each part share few kinds of delivery."""
    return write_yaml([delivery.to_qos()])
