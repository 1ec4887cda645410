"""``message_stubs.py FOLDER``: type stubs of every message, service and action of the sourced workspace, for mypy.

The generated Python classes of ROS interfaces carry no type information that a type checker can read; what they say of
their fields at run time (``get_fields_and_field_types``) is enough to write it down.
"""

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from ament_index_python import get_resource, get_resources

_PRIMITIVES = {"boolean": "bool", "octet": "bytes", "float": "float", "double": "float", "string": "str"}
_HEAD = """from array import array
from collections.abc import Iterable, MutableSequence
from typing import Any, ClassVar

import numpy as np
"""


def python_type(field: str) -> tuple[str, str]:
    """Returns what reading a field gives, and what may be written to it.

    Args:
        field: Its type as the generated class has it, such as ``sequence<double>`` or ``std_msgs/Header``.
    """
    several = re.fullmatch(r"sequence<(.+?)(?:, \d+)?>|(.+?)\[\d+\]", field)
    if several:
        item = python_type(several[1] or several[2])[0]
        if item in ("int", "float"):
            kind = "array[Any]" if several[1] else "np.ndarray[Any, Any]"
            return kind, f"Iterable[{item}] | np.ndarray[Any, Any]"
        return f"MutableSequence[{item}]", f"Iterable[{item}]"
    if "/" in field:
        package, name = field.split("/")
        return (f"{package}.msg.{name}",) * 2
    name = field.partition("<")[0]
    return (_PRIMITIVES.get(name.replace("wstring", "string"), "int"),) * 2


def message(kind: type, indent: str = "") -> Iterator[str]:
    """Yields the lines of one class."""
    yield f"{indent}class {kind.__name__.rpartition('_')[2]}:"
    for name, value in vars(type(kind)).items():
        if isinstance(value, property) and name.isupper():
            yield f"{indent}    {name}: ClassVar[{type(getattr(kind, name)).__name__}]"
    fields = {name: python_type(field) for name, field in kind.get_fields_and_field_types().items()}
    arguments = "".join(f", {name}: {written} = ..." for name, (_, written) in fields.items())
    yield f"{indent}    def __init__(self{', *' if fields else ''}{arguments}) -> None: ..."
    yield f"{indent}    @classmethod"
    yield f"{indent}    def get_fields_and_field_types(cls) -> dict[str, str]: ..."
    for name, (read, written) in fields.items():
        yield f"{indent}    @property"
        yield f"{indent}    def {name}(self) -> {read}: ..."
        yield f"{indent}    @{name}.setter"
        yield f"{indent}    def {name}(self, value: {written}) -> None: ..."


def interface(kind: type, parts: tuple[str, ...]) -> Iterator[str]:
    """Yields the lines of one interface: a message, or a service or action with its parts as inner classes."""
    if not parts:
        yield from message(kind)
        return
    yield f"class {kind.__name__}:"
    for part in parts:
        yield from message(getattr(kind, part), "    ")


def main() -> int:
    """Writes the stubs."""
    folder = Path(sys.argv[1])
    parts = {"msg": (), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
    for package in sorted(get_resources("rosidl_interfaces")):
        listed, _ = get_resource("rosidl_interfaces", package)
        files: dict[str, list[str]] = {}
        for line in listed.split():
            where, _, name = line.partition("/")
            if name.endswith((".msg", ".srv", ".action")):
                files.setdefault(where, []).append(name.partition(".")[0])
        for where, names in files.items():
            module = importlib.import_module(f"{package}.{where}")
            lines = [line for name in names for line in interface(getattr(module, name), parts[where])]
            text = "\n".join(lines)
            needed = sorted(set(re.findall(r"\b(\w+)\.msg\.", text)))
            stub = folder / package / where / "__init__.pyi"
            stub.parent.mkdir(parents=True, exist_ok=True)
            (folder / package / "__init__.pyi").touch()
            stub.write_text(_HEAD + "".join(f"import {other}.msg\n" for other in needed) + "\n" + text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
