"""Record of a data object."""

import zlib
from dataclasses import astuple, dataclass

from im_core.errors import ImError


@dataclass(frozen=True, slots=True)
class ObjectRecord:
    """Record of a data object, without the data.

    Attributes:
        name: Its name.
        version: Counts the puts from 1.
        type: ROS type, e.g. ``geometry_msgs/msg/Pose``.
        hash: Of the definition of that type (REP 2016).
        valid: Whether it may be used.
        place: ``net.place`` that stands for its existence and validity, or empty.
        source: Who changed it last.
        command: The command that it was put for, ``<node>/<incarnation of the node>-<number>``, or empty.
        stamp_ns: Testbed time of the last change [ns].
        size: Of the data [byte].
        data_checksum: Of the data (CRC-32).
    """

    name: str
    version: int
    type: str
    hash: str
    valid: bool
    place: str
    source: str
    command: str
    stamp_ns: int
    size: int
    data_checksum: int = 0

    def checksum(self) -> int:
        """Return the checksum of the object's complete record, including the checksum of the data (CRC-32)."""
        return zlib.crc32(repr(astuple(self)).encode())

    def fits(self, data: object) -> bool:
        """Return whether data, as read from the store, match the record of the object."""
        return isinstance(data, bytes) and len(data) == self.size and zlib.crc32(data) == self.data_checksum


@dataclass(frozen=True, slots=True)
class Damage:
    """Knowledge left of a lost object.

    Attributes:
        version: Its newest version, as far as is known; 0: it is not known.
        text: What is wrong, a clause.
    """

    version: int
    text: str


class DamagedObjectError(ImError):
    """A data object was stored and cannot be given: the bytes in the store are damaged.

    Args:
        store: File of the store.
        name: Name of the object; empty: which objects are lost is not known.
        damage: What is wrong, a clause.
    """

    default_code = "damaged"

    def __init__(self, store: str, name: str, damage: str) -> None:
        what = f"data object '{name}'" if name else "an object stored earlier"
        super().__init__(f"{what} cannot be read: in the object store {store} {damage}", store=store, object=name)
