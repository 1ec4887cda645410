"""YAML files into frozen, typed models; errors name file, line and field."""

import importlib.resources
from pathlib import Path
from typing import TypeVar

import pydantic
import yaml

from im_core.errors import ConfigError


class Model(pydantic.BaseModel):
    """Base of all configuration models: frozen, and no unknown fields."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as error:
        faults = [(line_of(node, fault["loc"]), field_name(fault["loc"]), fault) for fault in error.errors()]
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


def _sentence(message: str, value: object) -> str:
    if isinstance(value, (int, float, str, bool)) and repr(value) not in message:
        return f"{value!r}: {message}"
    return message
