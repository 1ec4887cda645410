"""Types of messages, services and actions by name."""

from importlib import import_module
from typing import Any

from im_core.errors import NotFoundError


def interface_class(name: str) -> Any:
    """The class of ``package/msg/Type``, ``package/srv/Type`` or ``package/action/Type``.

    Raises:
        NotFoundError: No such package or type is installed.
    """
    package, kind, type_name = (*name.split("/"), "", "")[:3]
    try:
        module = import_module(f"{package}.{kind}")
    except (ImportError, ValueError):
        raise NotFoundError(kind=f"package with {kind} types", name=package) from None
    known = [entry for entry in vars(module) if entry[:1].isupper() and "_" not in entry]
    if type_name not in known:
        raise NotFoundError(kind=f"{kind} type of {package}", name=type_name, known=known)
    return getattr(module, type_name)


def type_name(interface: type) -> str:
    """``geometry_msgs/msg/Pose`` for the class of that message."""
    package, kind = interface.__module__.split(".")[:2]
    return f"{package}/{kind}/{interface.__name__}"
