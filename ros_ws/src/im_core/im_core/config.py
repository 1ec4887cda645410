"""YAML files into frozen, typed models; errors name file, line and field."""

import importlib.resources
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import yaml

from im_core.errors import ConfigError


class Model(pydantic.BaseModel):
    """Base of all configuration models: frozen, and no unknown fields."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FieldError(ValueError):
    """For validators of a whole model: a rule over several fields that is broken at one of them.

    Args:
        location: Where below the model, e.g. ``("slots", 3, "name")``.
        sentence: What is wrong.
    """

    def __init__(self, location: tuple[int | str, ...], sentence: str) -> None:
        super().__init__(sentence)
        self.location = location


ModelT = TypeVar("ModelT", bound=pydantic.BaseModel)


def package_file(package: str, relative: str) -> Path:
    """Path of a data file shipped inside a Python package.

    Raises:
        ConfigError: There is no such file.
    """
    path = Path(str(importlib.resources.files(package))) / relative
    if not path.is_file():
        raise ConfigError(f"package {package} ships no file '{relative}'", package=package, file=relative)
    return path


def load_model(path: str | Path, model: type[ModelT]) -> ModelT:
    """Read a YAML file into a model.

    Args:
        path: The file.
        model: The pydantic model it must satisfy.

    Raises:
        ConfigError: The file is missing, is not YAML, or breaks a rule of the model; one line a fault,
            each ``file:line: field: what is wrong``.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}", file=str(path)) from error
    return parse_model(text, model, name=str(path))


def parse_model(text: str, model: type[ModelT], name: str) -> ModelT:
    """As :func:`load_model`, from text; ``name`` stands for the file in errors."""
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark is not None else 1
        problem = getattr(error, "problem", None) or str(error)
        raise ConfigError(f"{name}:{line}: not YAML: {problem}", file=name, line=line) from error
    except ValueError as error:
        raise ConfigError(f"{name}:1: not YAML: {error}", file=name, line=1) from error
    if node is None:
        raise ConfigError(f"{name}:1: the file is empty", file=name, line=1)
    _refuse_duplicates(node, name)
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as error:
        places = [(_location(fault), fault) for fault in error.errors()]
        faults = [(line_of(node, place), field_name(place), fault) for place, fault in places]
        lines = [
            f"{name}:{line}: {field + ': ' if field else ''}{_sentence(fault['msg'], fault['input'])}"
            for line, field, fault in faults
        ]
        raise ConfigError("\n".join(lines), file=name, line=faults[0][0], field=faults[0][1]) from error


def line_of(node: yaml.Node, location: tuple[int | str, ...]) -> int:
    """Line of a field, or of the nearest thing around it that exists; counts from 1."""
    for key in location:
        child: yaml.Node | None = None
        if isinstance(node, yaml.MappingNode):
            child = next((value for name, value in node.value if name.value == str(key)), None)
            if child is not None and isinstance(child, yaml.ScalarNode):
                return int(child.start_mark.line) + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
            child = node.value[key]
        if child is None:
            break
        node = child
    return int(node.start_mark.line) + 1


def field_name(location: tuple[int | str, ...]) -> str:
    """``("slots", 3, "limits")`` as ``slots[3].limits``."""
    text = ""
    for key in location:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else str(key)
    return text


def _location(fault: Any) -> tuple[int | str, ...]:
    below: tuple[int | str, ...] = getattr(fault.get("ctx", {}).get("error"), "location", ())
    return (*fault["loc"], *below)


def _refuse_duplicates(root: yaml.Node, name: str) -> None:
    """YAML's reader would take the last of several values of one key, in silence."""
    waiting: list[tuple[yaml.Node, tuple[int | str, ...]]] = [(root, ())]
    seen: set[int] = set()
    while waiting:
        node, place = waiting.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        items: list[tuple[int | str, yaml.Node]] = []
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                if any(key.value == known for known, _ in items):
                    field, line = field_name((*place, key.value)), key.start_mark.line + 1
                    raise ConfigError(f"{name}:{line}: {field}: given twice", file=name, line=line, field=field)
                items.append((key.value, value))
        elif isinstance(node, yaml.SequenceNode):
            items = list(enumerate(node.value))
        waiting += [(value, (*place, key)) for key, value in items]


def _sentence(message: str, value: object) -> str:
    message = message.removeprefix("Value error, ")
    if isinstance(value, (int, float, str, bool)) and repr(value) not in message:
        return f"{value!r}: {message}"
    return message
