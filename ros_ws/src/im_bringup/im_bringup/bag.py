"""Bags of ROS messages: MCAP through ``rosbags``; messages pass as the bytes the middleware delivers."""

import os
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml
from rosbags.interfaces import (
    Connection,
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from im_bringup.tasks.executables import prefixes
from im_core.bag import open_bag, unreadable_bag
from im_core.errors import DataError, StoreError
from im_core.files import read_text, write_whole

_FOREVER = QosTime(9223372036, 854775807)

#: Topics that start and end machines, and that carry tokens between nets: recorded, but replayed only by name.
CONTROL_TOPICS = ("/im/phase", "/im/task_status")
CONTROL_SUFFIXES = ("/tokens",)


#: Folder inside the bag where the part that is being written is, and after how many bytes the disk is looked at.
_OPEN = "open"
_LOOK_EVERY = 2**20


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


@dataclass(frozen=True)
class Delivery:
    """How the messages of a topic are delivered.

    Attributes:
        reliable: Sent again when lost.
        latched: The last ones reach whoever comes later.
        depth: How many are kept.
    """

    reliable: bool
    latched: bool
    depth: int

    def to_qos(self) -> Qos:
        """For the bag."""
        return Qos(
            QosHistory.KEEP_LAST,
            self.depth,
            QosReliability.RELIABLE if self.reliable else QosReliability.BEST_EFFORT,
            QosDurability.TRANSIENT_LOCAL if self.latched else QosDurability.VOLATILE,
            _FOREVER,
            _FOREVER,
            QosLiveliness.AUTOMATIC,
            _FOREVER,
            False,
        )

    @classmethod
    def of(cls, connection: Connection) -> Self:
        """As recorded; reliable and volatile if the bag does not say."""
        profiles = getattr(connection.ext, "offered_qos_profiles", [])
        if not profiles:
            return cls(reliable=True, latched=False, depth=100)
        reliable = all(profile.reliability is not QosReliability.BEST_EFFORT for profile in profiles)
        latched = all(profile.durability is QosDurability.TRANSIENT_LOCAL for profile in profiles)
        return cls(reliable, latched, max(1, *(profile.depth for profile in profiles)))


class Types:
    """Definitions of message types: those of Jazzy, and those of the sourced workspaces."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)

    def know(self, name: str) -> None:
        """Make sure that a type and all it contains are known.

        Args:
            name: E.g. ``im_msgs/msg/Firing``.

        Raises:
            DataError: No sourced workspace defines it.
        """
        if name in self.store.fielddefs:
            return
        found = get_types_from_msg(definition_of(name), name)
        for _, fields in found.values():
            for _, description in fields:
                for part in _named_types(description):
                    if part not in found:
                        self.know(part)
        self.store.register(found)


def definition_of(name: str) -> str:
    """Text of the ``.msg`` file of a type.

    Raises:
        DataError: No sourced workspace defines it.
    """
    package, _, rest = name.partition("/")
    for prefix in prefixes():
        path = prefix / "share" / package / f"{rest}.msg"
        if path.is_file():
            return read_text(path)
    raise DataError(f"the type {name} is not defined in any sourced workspace", type=name)


def _named_types(description: Any) -> Iterator[str]:
    kind, argument = description
    if kind == Nodetype.NAME:
        yield argument
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _named_types(argument[0])


class BagWriter:
    """Writes a bag in parts: each is a file that is complete when the next begins, and can be read from then on.

    A recorder that is killed loses the part that it was writing, and no other; so does a disk that is full.

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
        self._types = Types()
        self._topics: dict[str, tuple[str, Delivery]] = {}
        self._parts: list[dict[str, Any]] = []
        self._connections: dict[str, Connection] = {}
        self._size, self._looked, self._begun_ns = 0, 0, 0
        self._broken: StoreError | None = None
        try:
            path.mkdir(parents=True)
            self._begin_part()
        except (WriterError, OSError) as error:
            raise DataError(f"the bag {path} cannot be made: {error}", path=str(path)) from error

    def add_topic(self, topic: str, type_name: str, delivery: Delivery) -> None:
        """Announce a topic.

        Raises:
            DataError: Its type is not defined in any sourced workspace.
        """
        self._types.know(type_name)
        self._topics[topic] = type_name, delivery
        self.counts[topic] = 0
        self._connect(topic)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a message.

        Args:
            topic: An announced topic.
            stamp_ns: When it came, wall time [ns].
            data: The message, serialised (CDR).

        Raises:
            StoreError: The disk is full, or nearly so; :meth:`close` keeps what was written before.
        """
        if self._broken is not None:
            raise self._broken
        try:
            self._writer.write(self._connections[topic], stamp_ns, data)
        except OSError as error:
            self._writer.abort()
            self._broken = StoreError.of("written", self.path, error)
            raise self._broken from error
        self.counts[topic] += 1
        self._size += len(data)
        self._begun_ns = self._begun_ns or stamp_ns
        if self._size >= self._looked + _LOOK_EVERY:
            self._looked = self._size
            free = shutil.disk_usage(self.path).free
            if free < self._limits.free_bytes:
                kept = self._limits.free_bytes / 2**20
                reason = f"{free / 2**20:.0f} MiB are free on the disk, and {kept:.0f} stay free"
                raise StoreError(f"{self.path} is not written any longer: {reason}", file=str(self.path), reason=reason)
        if self._size >= self._limits.size_bytes or stamp_ns - self._begun_ns >= self._limits.time_ns:
            self._end_part()
            self._begin_part()

    def close(self) -> None:
        """Finish the bag.

        Raises:
            StoreError: Its last part cannot be written; those before it are kept.
        """
        if self._broken is None:
            self._end_part()
        shutil.rmtree(self.path / _OPEN, ignore_errors=True)

    def _begin_part(self) -> None:
        self._writer = Writer(self.path / _OPEN, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._size, self._looked, self._begun_ns = 0, 0, 0
        for topic in self._topics:
            self._connect(topic)

    def _connect(self, topic: str) -> None:
        type_name, delivery = self._topics[topic]
        self._connections[topic] = self._writer.add_connection(
            topic, type_name, typestore=self._types.store, offered_qos_profiles=[delivery.to_qos()]
        )

    def _end_part(self) -> None:
        """Close the file that is written, give it its name, and list it."""
        name = f"{self.path.name}_{len(self._parts)}.mcap" if self._parts else f"{self.path.name}.mcap"
        part = self.path / _OPEN
        try:
            self._writer.close()
            described = yaml.safe_load((part / "metadata.yaml").read_text(encoding="utf-8"))
            os.replace(part / f"{_OPEN}.mcap", self.path / name)
            self._parts.append(_named(described["rosbag2_bagfile_information"], name))
            content = {"rosbag2_bagfile_information": _joined(self._parts)}
            write_whole(self.path / "metadata.yaml", yaml.safe_dump(content, sort_keys=False))
            shutil.rmtree(part)
        except OSError as error:
            self._broken = StoreError.of("written", self.path, error)
            raise self._broken from error


def _named(part: dict[str, Any], name: str) -> dict[str, Any]:
    """The description of a part whose file got its name."""
    return {**part, "relative_file_paths": [name], "files": [{**part["files"][0], "path": name}]}


def _joined(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The description of a bag of several parts; the last one has all topics."""
    files = [file for part in parts for file in part["files"] if file["message_count"]] or parts[0]["files"]
    begin = min(file["starting_time"]["nanoseconds_since_epoch"] for file in files)
    end = max(file["starting_time"]["nanoseconds_since_epoch"] + file["duration"]["nanoseconds"] for file in files)
    counts: Counter[str] = Counter()
    for part in parts:
        for topic in part["topics_with_message_count"]:
            counts[topic["topic_metadata"]["name"]] += topic["message_count"]
    return {
        **parts[-1],
        "relative_file_paths": [name for part in parts for name in part["relative_file_paths"]],
        "files": [file for part in parts for file in part["files"]],
        "starting_time": {"nanoseconds_since_epoch": begin},
        "duration": {"nanoseconds": end - begin},
        "message_count": sum(part["message_count"] for part in parts),
        "topics_with_message_count": [
            {**topic, "message_count": counts[topic["topic_metadata"]["name"]]}
            for topic in parts[-1]["topics_with_message_count"]
        ],
    }


class BagReader:
    """Reads a bag, MCAP or SQLite.

    Args:
        path: Folder of the bag, or a file in it.

    Raises:
        DataError: It is not a bag that was closed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path.parent if path.is_file() else path
        try:
            self._reader = open_bag(self._path)
        except DataError as error:
            raise DataError(f"{path} is not a bag that can be read: {error.message}", path=str(path)) from error

    def __enter__(self) -> Self:
        """Nothing to do; the bag is open."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self._reader.close()

    @property
    def duration_s(self) -> float:
        """From the first to the last message [s]."""
        return self._reader.duration * 1e-9

    @property
    def types(self) -> Mapping[str, str]:
        """Type of each topic."""
        return {connection.topic: connection.msgtype for connection in self._reader.connections}

    @property
    def counts(self) -> Mapping[str, int]:
        """Number of messages of each topic."""
        return {connection.topic: connection.msgcount for connection in self._reader.connections}

    @property
    def deliveries(self) -> Mapping[str, Delivery]:
        """Delivery of each topic."""
        return {connection.topic: Delivery.of(connection) for connection in self._reader.connections}

    def messages(self, topics: Iterable[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of arrival [ns] and bytes of the messages of some topics, in order of time.

        Raises:
            DataError: The bag is damaged.
        """
        wanted = set(topics)
        connections = [connection for connection in self._reader.connections if connection.topic in wanted]
        if not connections:
            return
        messages = iter(self._reader.messages(connections))
        while True:
            try:
                connection, stamp_ns, data = next(messages)
            except StopIteration:
                return
            except Exception as error:  # what a reader meets in bytes that were cut or spoilt has any name
                raise unreadable_bag(self._path, error) from error
            yield connection.topic, stamp_ns, bytes(data)


def chosen_topics(known: Iterable[str], asked: Iterable[str]) -> list[str]:
    """The topics of a bag to replay.

    Args:
        known: Those in the bag.
        asked: Those asked for; empty: all but those that steer a machine.

    Raises:
        DataError: One that was asked for is not in the bag.
    """
    have, wanted = sorted(known), list(asked)
    for topic in wanted:
        if topic not in have:
            raise DataError(f"the bag has no topic {topic}; it has {', '.join(have)}", topic=topic)
    return wanted or [topic for topic in have if topic not in CONTROL_TOPICS and not topic.endswith(CONTROL_SUFFIXES)]


def default_folder(stamp: str) -> Path:
    """Where a bag goes when no folder is named: ``bags/<stamp>`` in $IM_ROOT, or where one stands."""
    return Path(os.environ.get("IM_ROOT") or ".") / "bags" / stamp
