"""Definitions of message types with all contained types, in the form used by MCAP files.

Messages as ``ros2msg``. Events of services and actions as ``ros2idl``: their names, such as ``Advance_Event``, are
none of a message file, and readers of ``ros2msg`` refuse them.
"""

import functools
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import TypesysError, get_types_from_msg

from im_bag.reading import defined_types
from im_core.errors import DataError
from im_core.executables import prefixes
from im_core.files import read_text

_LINE = "=" * 80
_SEPARATOR = re.compile(r"^---.*\n?", re.MULTILINE)
_PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
_IDL_NAMES = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}


#: IDL has no empty structures: rosidl fills them.
_FILLED = "structure_needs_at_least_one_member"
#: Types of messages that are others in IDL.
_SAME = {"char": "uint8"}


class Definition(NamedTuple):
    """Definition of a type and of all contained types.

    Attributes:
        encoding: Of the text: ``ros2msg`` or ``ros2idl``.
        text: The definitions, that of the type itself first.
    """

    encoding: str
    text: str


def full_definition(name: str) -> Definition:
    """Return the definition of a type, followed by the definitions of all contained types.

    Args:
        name: E.g. ``im_msgs/msg/Firing``, or ``im_msgs/srv/Advance_Event``.

    Raises:
        DataError: No sourced workspace defines it, or one that it contains.
    """
    found: dict[str, str] = {}
    waiting = [name]
    while waiting:
        each = waiting.pop(0)
        if each not in found:
            found[each] = definition_of(each)
            waiting += _contained(each, found[each])
    if "/msg/" not in name:
        return Definition("ros2idl", "".join(f"{_LINE}\nIDL: {each}\n{_idl(each, found[each])}" for each in found))
    first, *rest = found
    contained = "".join(f"\n{_LINE}\nMSG: {_short(each)}\n{found[each]}" for each in rest)
    return Definition("ros2msg", found[first] + contained)


def changed_types(name: str, recorded: MessageDefinition) -> list[str]:
    """Return the types with other fields here than in a bag, of a type and all contained types; empty if unknown.

    Args:
        name: E.g. ``im_msgs/msg/Firing``.
        recorded: As the bag defines it.

    Raises:
        DataError: No sourced workspace defines it, or one that it contains.
    """
    if not recorded.data.strip():
        return []
    encoding, text = full_definition(name)
    form = MessageDefinitionFormat.MSG if encoding == "ros2msg" else MessageDefinitionFormat.IDL
    try:
        there, here = (defined_types(name, each) for each in (recorded, MessageDefinition(form, text)))
    except TypesysError:  # others define the events of services in a way that is not read
        return []
    return sorted(each for each in there.keys() & here.keys() if _fields(there[each]) != _fields(here[each]))


def _fields(definition: tuple[Any, Any]) -> list[tuple[str, Any]]:
    """Return the fields by name and description, in a form common to messages and IDL."""
    return [(name, _alike(description)) for name, description in definition[1] if name != _FILLED]


def _alike(description: Any) -> Any:
    kind, argument = description
    if kind == Nodetype.BASE:
        return kind, (_SAME.get(argument[0], argument[0]), argument[1])
    return (kind, argument) if kind == Nodetype.NAME else (kind, (_alike(argument[0]), argument[1]))


@functools.lru_cache(maxsize=1024)
def definition_of(name: str) -> str:
    """Return the text of one type; generate the text of parts and events of services and actions as ROS does.

    Raises:
        DataError: No sourced workspace defines it.
    """
    package, kind, own = (*name.split("/"), "", "")[:3]
    base, _, part = own.partition("_")
    if kind not in _PARTS or not part:
        return _file(name, package, f"{kind}/{own}.msg")
    texts = _SEPARATOR.split(_file(name, package, f"{kind}/{base}.{kind}"))
    made = {
        "SendGoal_Request": f"unique_identifier_msgs/UUID goal_id\n{package}/{base}_Goal goal\n",
        "SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
        "GetResult_Request": "unique_identifier_msgs/UUID goal_id\n",
        "GetResult_Response": f"int8 status\n{package}/{base}_Result result\n",
    }
    made.update(zip(_PARTS[kind], texts, strict=False))
    if part not in made and part.endswith("Event"):
        whole = own.removesuffix("_Event")
        made[part] = (
            "service_msgs/ServiceEventInfo info\n"
            f"{package}/{whole}_Request[<=1] request\n{package}/{whole}_Response[<=1] response\n"
        )
    if part not in made:
        raise DataError(f"the type {name} is not defined in any sourced workspace", type=name)
    return made[part]


def _file(name: str, package: str, path: str) -> str:
    for folder in _folders(package):
        if (file := folder / path).is_file():
            return read_text(file)
    raise DataError(f"the type {name} is not defined in any sourced workspace", type=name)


@functools.lru_cache(maxsize=1024)
def _folders(package: str) -> Sequence[Path]:
    """Return the shared folders of a package in the workspaces; each package has a prefix, most lack the folder."""
    folders = (prefix / "share" / package for prefix in prefixes())
    return [folder for folder in folders if folder.is_dir()]


def _contained(name: str, text: str) -> Iterator[str]:
    """Yield the full names of the types of a definition's fields."""
    for _, description in _read(name, text)[1]:
        for part in _named_types(description):
            yield _existing(part)


@functools.lru_cache(maxsize=1024)
def _read(name: str, text: str) -> tuple[Any, Any]:
    """Constants, by name, type and value, and fields, by name and description, of a definition."""
    try:
        ((constants, fields),) = get_types_from_msg(text, "{0}/msg/{2}".format(*name.split("/"))).values()
    except TypesysError as error:
        raise DataError(f"the definition of {name} cannot be read: {error}", type=name) from error
    return constants, fields


def _idl(name: str, text: str) -> str:
    """Return a definition in IDL, as made by ``rosidl_adapter``, without comments and defaults."""
    package, kind, own = name.split("/")
    constants, fields = _read(name, text)
    members = [_idl_member(each, description) for each, description in fields]
    said = [f"const {_IDL_NAMES.get(base, base)} {each} = {_idl_value(value)};" for each, base, value in constants]
    told = f"module {own}_Constants {{ {' '.join(said)} }}; " if said else ""
    members = members or [f"uint8 {_FILLED};"]
    return f"module {package} {{ module {kind} {{ {told}struct {own} {{ {' '.join(members)} }}; }}; }};\n"


def _idl_member(name: str, description: Any) -> str:
    kind, argument = description
    if kind == Nodetype.ARRAY:
        return f"{_idl_type(argument[0])} {name}[{argument[1]}];"
    return f"{_idl_type(description)} {name};"


def _idl_type(description: Any) -> str:
    kind, argument = description
    if kind == Nodetype.NAME:
        return _existing(argument).replace("/", "::")
    if kind == Nodetype.SEQUENCE:
        of, most = argument
        return f"sequence<{_idl_type(of)}, {most}>" if most else f"sequence<{_idl_type(of)}>"
    base, most = argument
    return f"{base}<{most}>" if most else _IDL_NAMES.get(base, base)


def _idl_value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).upper()
    return json.dumps(value) if isinstance(value, str) else str(value)


def _existing(name: str) -> str:
    """Return the full name of a field's type; parts of services and actions are written like messages."""
    if "_" not in name.rpartition("/")[2]:
        return name
    for kind in ("/msg/", "/srv/", "/action/"):
        try:
            definition_of(name.replace("/msg/", kind))
        except DataError:
            continue
        return name.replace("/msg/", kind)
    return name


def _named_types(description: Any) -> Iterator[str]:
    kind, argument = description
    if kind == Nodetype.NAME:
        yield argument
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _named_types(argument[0])


def _short(name: str) -> str:
    package, _, own = name.split("/")
    return f"{package}/{own}"
