"""Decoded messages of a bag (rosbag2: MCAP, SQLite); each fault of a bag is reported in one sentence."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag2 import Reader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from im_bag import unpacking
from im_bag.files import METADATA, complete_bag
from im_bag.storage import WholeReader
from im_core.errors import DataError, nearest, printable
from im_core.files import FileError, check_regular

MessageT = TypeVar("MessageT")

_PACKED = "*.zstd"
#: What to do about another kind of bag.
_CONVERTED = "of which rosbags-convert makes one of ROS 2"
#: Endings of the files of a bag.
_FILES = (".mcap", ".db3", ".zstd", ".yaml")
_IDL_PART = re.compile("^=+\nIDL: .*\n", re.MULTILINE)

#: Bytes before the content of a message.
_ENCAPSULATION = 4

unpacking.install()


@dataclass(frozen=True)
class BagMessage:
    """A message of a bag.

    Attributes:
        topic: Where it was sent.
        type: E.g. ``sensor_msgs/msg/JointState``.
        content: Its fields, as ``rosbags`` decodes them.
        logged_ns: When it was recorded [ns].
    """

    topic: str
    type: str
    content: Any
    logged_ns: int


def open_bag(bag: Path) -> Reader:
    """Open a bag after a check; complete the bag first if the recorder was killed.

    How long it is has no limit: its messages are read one by one.

    Args:
        bag: Folder of the bag, or a file of it.

    Raises:
        DataError: It cannot be read: a file of it is a FIFO or a device, its metadata are larger or deeper than such
            are, its files unpack to too much, or it is damaged; the last may show only while messages are read.
    """
    try:
        folder = bag if bag.is_dir() else None
        if folder and not any(path.suffix in _FILES for path in folder.iterdir()):
            raise FileError(bag, no_bag_in(folder))
        if bag.suffix == ".bag" and not folder:
            raise FileError(bag, f"is a bag of ROS 1, {_CONVERTED}")
        for path in folder.iterdir() if folder else (bag,):
            if not path.is_dir():
                check_regular(path, path.stat())
        complete_bag(bag)
        if folder and not (folder / METADATA).exists():
            raise FileError(bag, no_bag_in(folder))
        if folder:
            unpacking.check_files(bag, sorted(folder.glob(_PACKED)))
        reader = WholeReader(bag)
        reader.open()
    except FileError:
        raise
    except Exception as error:
        raise unreadable_bag(bag, error) from error
    return reader


def no_bag_in(folder: Path) -> str:
    """Return the sentence: the folder is no bag, though a bag was expected there."""
    if single := sorted(path.name for path in folder.glob("*.db3")):
        return f"lacks {METADATA}; name one of its files: {', '.join(single[:8])}"
    if any(folder.glob(_PACKED)):
        return f"lacks {METADATA}, without which packed files are not read"
    if old := sorted(path.name for path in folder.glob("*.bag")):
        return f"is no bag of ROS 2: {old[0]} is one of ROS 1, {_CONVERTED}"
    bags = sorted(path.name for path in folder.iterdir() if path.is_dir() and any(path.glob("*.mcap")))
    return f"is a folder of bags; name one: {', '.join(bags[:8])}" if bags else "there is no bag in it"


def topics_of(bag: Path) -> dict[str, str]:
    """Type of each topic of a bag.

    Args:
        bag: Folder of the bag, or a file of it.

    Raises:
        DataError: It cannot be read.
    """
    with closing(open_bag(bag)) as reader:
        return {connection.topic: connection.msgtype for connection in reader.connections}


def messages_of(
    bag: Path,
    wanted: Mapping[str, Collection[str]],
    fields: Mapping[str, Collection[str]] | None = None,
    logged_ns: int | None = None,
) -> Iterator[BagMessage]:
    """The messages of some topics, in order of the time of recording.

    Args:
        bag: Folder of the bag, or a file of it.
        wanted: Topics, and which types each may have.
        fields: Of types that may have changed since: the fields that are read.
        logged_ns: Only messages that were recorded then [ns]; None: all.

    Raises:
        DataError: The bag cannot be read, has no such topic, one of another type, or of a type that it does not define
            or defines without such a field; says what there is.
    """
    with closing(open_bag(bag)) as reader:
        chosen = [connection for connection in reader.connections if connection.topic in wanted]
        have = {connection.topic for connection in chosen}
        for topic in wanted:
            if topic not in have:
                hint = nearest(topic, (connection.topic for connection in reader.connections))
                raise DataError(f"{bag}: there is no topic '{topic}' in it{hint}", topic=topic)
        for connection in chosen:
            if connection.msgtype not in (types := wanted[connection.topic]):
                allowed = " or ".join(types)
                raise DataError(f"{bag}: topic '{connection.topic}' is {connection.msgtype}, not {allowed}")
        store = _types(bag, chosen)
        for name, read in (fields or {}).items():
            if name in store.types and (missing := sorted({*read} - {field for field, _ in store.fielddefs[name][1]})):
                raise DataError(
                    f"{bag}: {name} is defined there without '{missing[0]}': it was recorded with another version of "
                    "this workspace, which can read it",
                    type=name,
                )
        yield from read_on(bag, _decoded(reader, chosen, store, logged_ns))


def read_on(bag: Path, messages: Iterator[MessageT]) -> Iterator[MessageT]:
    """Yield the messages read from a bag, unchanged.

    Raises:
        DataError: The bag is damaged where it is read.
    """
    while True:
        try:
            message = next(messages)
        except StopIteration:
            return
        except Exception as error:  # what a reader meets in bytes that were cut or spoilt has any name
            raise unreadable_bag(bag, error) from error
        yield message


def _decoded(
    reader: Reader, connections: Sequence[Connection], store: Typestore, only_ns: int | None
) -> Iterator[BagMessage]:
    until = None if only_ns is None else only_ns + 1
    for connection, logged_ns, data in reader.messages(connections, only_ns, until):
        content = deserialized(store, data, connection.msgtype)
        yield BagMessage(connection.topic, connection.msgtype, content, logged_ns)


def deserialized(store: Typestore, data: bytes | memoryview, name: str) -> Any:
    """Return a message, also with bytes behind the end, as ``rclpy.serialization`` leaves of a buffer.

    Jazzy's ``serialize_message`` takes 4 bytes too many for each empty list of 64-bit numbers.

    Raises:
        SerdeError: It is no message of the type.
    """
    try:
        return store.deserialize_cdr(data, name)
    except SerdeError:
        known = store.get_msgdef(name)
        read = known.deserialize_cdr_le if data[1] else known.deserialize_cdr_be
        message, end = read(memoryview(data)[_ENCAPSULATION:], 0, known.cls, store)
        if len(data) - _ENCAPSULATION - end >= 8 + 4 * _empty_lists(message):
            raise
        return message


def _empty_lists(value: Any) -> int:
    if isinstance(value, list | np.ndarray):
        return sum(map(_empty_lists, value)) if isinstance(value, list) and value else int(len(value) == 0)
    return sum(map(_empty_lists, vars(value).values())) if hasattr(value, "__dict__") else 0


def _types(bag: Path, connections: Sequence[Connection]) -> Typestore:
    """Return the types of Jazzy, and other types as defined in the bag.

    Raises:
        DataError: It does not define one, or defines it in several ways, or in one that makes no sense.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    hashes: dict[str, str] = {}
    for connection in connections:
        if connection.msgtype not in store.types and not connection.msgdef.data.strip():
            text = f"there is no definition of {connection.msgtype} in it, by which {connection.topic} could be read"
            raise DataError(f"{bag}: {text}", type=connection.msgtype)
        if connection.digest and hashes.setdefault(connection.msgtype, connection.digest) != connection.digest:
            text = f"there are several definitions of {connection.msgtype} in it, as of versions of a workspace"
            raise DataError(f"{bag}: {text}", type=connection.msgtype)
        try:
            defined = defined_types(connection.msgtype, connection.msgdef)
            store.register({name: spec for name, spec in defined.items() if name not in store.types})
        except TypesysError as error:
            text = f"the definition of {connection.msgtype}, the type of {connection.topic}, cannot be read"
            raise DataError(f"{bag}: {text}", type=connection.msgtype) from error
    return store


def defined_types(name: str, definition: MessageDefinition) -> Typesdict:
    """Return the types in a definition, as read by ``rosbags``.

    Raises:
        TypesysError: It cannot be read.
    """
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, name)
    types: Typesdict = {}
    if definition.format == MessageDefinitionFormat.IDL:
        for part in filter(None, _IDL_PART.split(definition.data)):
            types |= get_types_from_idl(part)
    return types


def unreadable_bag(bag: Path, error: Exception) -> DataError:
    """Return the exception of a bag's reader as an error of one sentence, even if the exception has many lines."""
    told = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    reason = " ".join(told.split()) or type(error).__name__
    return FileError(bag, f"cannot be read: {printable(reason)[:200]}")
