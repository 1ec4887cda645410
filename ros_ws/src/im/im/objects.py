"""Data objects of the machine (paper, section 6)."""

import importlib
from array import array
from collections.abc import Iterator
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from im.connection import PATIENCE_S, Connection
from im.errors import MachineError, require
from im.messages import number_of
from im_msgs.msg import ObjectInfo
from im_msgs.srv import AppendObject, GetObject, InvalidateObject, ListObjects, PutObject


class DataObjects:
    """Data objects by name, as ROS messages."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def infos(self, prefix: str = "") -> list[ObjectInfo]:
        """Return name, type, version and validity of the objects with a prefix."""
        return list(self._ask(ListObjects, "list", prefix=prefix).objects)

    def get(self, name: str, wait: float = 0.0) -> Any:
        """Return the message of an object.

        Args:
            name: Name of the object.
            wait: Longest wait until the object is valid [s].

        Raises:
            MachineError: There is no valid object of the name.
        """
        longest = number_of("wait", wait)
        answer = self._ask(GetObject, "get", PATIENCE_S + longest, name=name, timeout=longest)
        return deserialize_message(bytes(answer.data), _type(answer.object.type))

    def put(self, name: str, message: Any) -> int:
        """Store a message as a valid object; return the version.

        Raises:
            MachineError: The object was refused.
        """
        return int(self._ask(PutObject, "put", name=name, **_data(message)).object.version)

    def append(self, name: str, message: Any) -> int:
        """Append the sequences of a message to the sequences of an object; return the version.

        Raises:
            MachineError: There is no valid object of the name and type.
        """
        request = f"{self._connection.name}/{self._connection.count()}"
        return int(self._ask(AppendObject, "append", name=name, request=request, **_data(message)).object.version)

    def invalidate(self, name: str) -> None:
        """Declare an object invalid.

        Raises:
            MachineError: There is no object of the name.
        """
        self._ask(InvalidateObject, "invalidate", name=name)

    def __getitem__(self, name: str) -> Any:
        """Return the message of an object."""
        return self.get(name)

    def __setitem__(self, name: str, message: Any) -> None:
        """Store a message as a valid object."""
        self.put(name, message)

    def __contains__(self, name: object) -> bool:
        """Return whether a valid object has the name."""
        return any(info.name == name and info.valid for info in self.infos(str(name)))

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the valid objects."""
        return iter([info.name for info in self.infos() if info.valid])

    def _ask(self, kind: Any, service: str, patience: float = PATIENCE_S, **fields: object) -> Any:
        if "source" in kind.Request.get_fields_and_field_types():
            fields["source"] = self._connection.name
        return require(self._connection.call(kind, f"/dom/{service}", patience, **fields))


def _type(name: str) -> Any:
    """Return the class of a message type, such as ``std_msgs/msg/String``.

    Raises:
        MachineError: The type is not installed here.
    """
    package, _, rest = name.partition("/")
    folder, _, message = rest.partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), message)
    except (ImportError, AttributeError) as error:
        raise MachineError(f"message type {name} is not installed on this host", "not_found") from error


def _data(message: Any) -> dict[str, Any]:
    """Return type and bytes of a message.

    Raises:
        MachineError: It is no message, or a field has a value of another type.
    """
    if not hasattr(type(message), "get_fields_and_field_types"):
        raise MachineError(f"{message!r:.60} is no ROS message, as std_msgs.msg.String(data='x') is", "argument")
    package, _, rest = type(message).__module__.partition(".")
    kind = f"{package}/{rest.partition('.')[0]}/{type(message).__name__}"
    try:
        data = serialize_message(message)
    except (TypeError, ValueError, OverflowError, SystemError) as error:
        raise MachineError(f"a field of {message!r:.60} has a value of another type", "argument") from error
    return {"type": kind, "data": array("B", data)}
