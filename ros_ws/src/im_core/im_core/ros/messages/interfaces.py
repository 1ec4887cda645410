"""Types of messages, services and actions by name."""

from functools import cache
from importlib import import_module
from typing import Any

from ament_index_python import has_resource

from im_core.errors import DataError, NotFoundError

KINDS = ("msg", "srv", "action")


@cache
def interface_class(name: str) -> Any:
    """The class of ``package/msg/Type``, ``package/srv/Type`` or ``package/action/Type``, or of a service's events.

    Nothing is imported but what an installed package has for its types: names come from anybody.

    Raises:
        NotFoundError: No such package or type is installed.
    """
    if name.count("/") != 2:
        raise NotFoundError(kind="type of the form package/msg/Type", name=name)
    package, kind, type_name = name.split("/")
    try:
        if kind not in KINDS or not has_resource("rosidl_interfaces", package):
            raise ImportError(package)
        module = import_module(f"{package}.{kind}")
    except (ImportError, ValueError, OSError):
        raise NotFoundError(kind=f"package with {kind} types", name=package) from None
    known = [entry for entry in vars(module) if entry[:1].isupper() and "_" not in entry]
    if type_name not in known and not (type_name.endswith("_Event") and hasattr(module, type_name)):
        raise NotFoundError(kind=f"{kind} type of {package}", name=type_name, known=known)
    return getattr(module, type_name)


def message_class(name: str) -> Any:
    """Return the class of a type possible on a topic: ``package/msg/Type``, or the events of a service.

    Raises:
        NotFoundError: No such package or type is installed.
        DataError: It is the type of a service or an action.
    """
    found = interface_class(name)
    if not hasattr(found, "get_fields_and_field_types"):
        raise DataError(f"{name} is no type of messages, but that of a service or an action", type=name)
    return found


def decoded(data: bytes, interface: type) -> Any:
    """Decode CDR bytes to a message.

    Raises:
        DataError: They are none of this type.
    """
    from rclpy.impl.implementation_singleton import rclpy_implementation  # programs that ask for types have no ROS
    from rclpy.serialization import deserialize_message

    try:
        return deserialize_message(data, interface)
    except (rclpy_implementation.RMWError, UnicodeError, MemoryError):
        raise DataError(f"{len(data)} bytes are no {type_name(interface)}") from None


def type_name(interface: type) -> str:
    """Return the type name of a message class, as ``geometry_msgs/msg/Pose``."""
    package, kind = interface.__module__.split(".")[:2]
    return f"{package}/{kind}/{interface.__name__}"
