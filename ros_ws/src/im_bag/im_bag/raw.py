"""Reader of bags, MCAP or SQLite; an interrupted bag is completed first."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from im_bag.definitions import changed_types
from im_bag.delivery import Delivery
from im_bag.files import METADATA
from im_bag.reading import open_bag, unreadable_bag
from im_core.errors import DataError, nearest

#: Topics that start and end machines, that carry tokens between nets, and that move arms: recorded, but replayed only
#: by name.
CONTROL_TOPICS = ("/im/phase", "/im/task_status")
CONTROL_SUFFIXES = ("/tokens", "/command/setpoints", "/command/torques", "/joint_trajectory")


class BagReader:
    """Reads a bag, MCAP or SQLite.

    Args:
        path: Folder of the bag, or a file in it; one that lies in a folder without metadata is taken by itself.

    Raises:
        DataError: It is not a bag that was closed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path.parent if path.is_file() and (path.parent / METADATA).exists() else path
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
        """Close the bag."""
        self._reader.close()

    @property
    def begin_ns(self) -> int:
        """Time of the first message [ns]."""
        return int(self._reader.start_time)

    @property
    def hashes(self) -> Mapping[str, str]:
        """Hash of the type of each topic, empty where the bag does not say."""
        return {connection.topic: connection.digest for connection in self._reader.connections}

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
        counts: Counter[str] = Counter()
        for connection in self._reader.connections:
            counts[connection.topic] += connection.msgcount
        return counts

    @property
    def deliveries(self) -> Mapping[str, Delivery]:
        """Delivery of each topic."""
        return {connection.topic: Delivery.of(connection) for connection in self._reader.connections}

    def check_type(self, topic: str) -> None:
        """Refuse a topic with several types, or with several definitions of one type.

        Raises:
            DataError: It has several types, or several definitions of one.
        """
        connections = [connection for connection in self._reader.connections if connection.topic == topic]
        types = sorted({connection.msgtype for connection in connections})
        if len(types) > 1:
            raise DataError(f"{topic} has several types in {self._path}: {', '.join(types)}", topic=topic)
        if len({connection.digest for connection in connections} - {""}) > 1:
            raise DataError(f"{topic} has several definitions of {types[0]} in {self._path}", topic=topic)

    def check_definition(self, topic: str) -> None:
        """Refuse a topic if the fields of the type differ between the bag and the local definition.

        Raises:
            DataError: It has.
        """
        for connection in self._reader.connections:
            if connection.topic == topic and changed_types(connection.msgtype, connection.msgdef):
                raise changed_type(topic, connection.msgtype)

    def messages(
        self, topics: Iterable[str], begin_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of arrival [ns] and bytes of the messages of some topics, in order of time.

        Args:
            topics: Their names.
            begin_ns: From when on [ns].
            end_ns: Before when [ns].

        Raises:
            DataError: The bag is damaged, or as of :meth:`check_type`.
        """
        wanted = set(topics)
        for topic in wanted:
            self.check_type(topic)
        connections = [connection for connection in self._reader.connections if connection.topic in wanted]
        if not connections:
            return
        messages = iter(self._reader.messages(connections, start=begin_ns, stop=end_ns))
        while True:
            try:
                connection, stamp_ns, data = next(messages)
            except StopIteration:
                return
            except Exception as error:  # what a reader meets in bytes that were cut or spoilt has any name
                raise unreadable_bag(self._path, error) from error
            yield connection.topic, stamp_ns, bytes(data)


def changed_type(topic: str, type_name: str) -> DataError:
    """Return the error: a topic's messages in the bag have another definition than the type has here."""
    return DataError(
        f"{topic}: {type_name} has another definition here than when it was recorded; leave the topic out (--topics), "
        "or replay with the workspace of the recording",
        topic=topic,
    )


def chosen_topics(known: Iterable[str], asked: Iterable[str]) -> list[str]:
    """The topics of a bag to replay.

    Args:
        known: Those in the bag.
        asked: Those asked for; empty: all but those that steer a machine, and hidden ones (events of services).

    Raises:
        DataError: One that was asked for is not in the bag.
    """
    have, wanted = sorted(known), list(dict.fromkeys(asked))
    for topic in wanted:
        if topic not in have:
            raise DataError(f"the bag has no topic {topic}{nearest(topic, have)}", topic=topic)
    return wanted or [topic for topic in have if not _is_control(topic) and "/_" not in topic]


def _is_control(topic: str) -> bool:
    return topic in CONTROL_TOPICS or topic.endswith(CONTROL_SUFFIXES)


def default_folder(stamp: str) -> Path:
    """Where a bag goes when no folder is named: ``bags/<stamp>`` in $IM_ROOT, or where one stands."""
    return Path(os.environ.get("IM_ROOT") or ".") / "bags" / stamp
