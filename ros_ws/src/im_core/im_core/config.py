"""The one checker of data: YAML files into frozen, typed models; complaints name file, line and field.

:func:`load_model` and :func:`parse_model` are for files. Whoever validates data of another origin with a model (a
request, a net file put together) tells what is wrong with :func:`faults`.
"""

import importlib.resources
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, TypeVar, Union, cast, get_args, get_origin

import pydantic

from im_core.errors import ConfigError, nearest, quoted_text, shortened
from im_core.files import MEBIBYTE, FileError, read_text
from im_core.text.yamltext import (
    Location,
    Quotation,
    RepeatedKeyError,
    Value,
    YamlError,
    as_data,
    find,
    read_yaml,
)


class Model(pydantic.BaseModel):
    """Base of all models of data: frozen, and no unknown fields."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FieldError(ValueError):
    """Error for validators of a whole model: a rule over several fields, broken at one field.

    Args:
        location: Where below the model, e.g. ``("slots", 3, "name")``.
        sentence: What is wrong.
    """

    def __init__(self, location: Location, sentence: str) -> None:
        super().__init__(sentence)
        self.location = location


ModelT = TypeVar("ModelT", bound=pydantic.BaseModel)
_MOST_FAULTS = 50
_LARGEST_YAML = 16 * MEBIBYTE


@dataclass(frozen=True, slots=True)
class Fault:
    """One complaint of a model.

    Attributes:
        kind: Kind of error, as pydantic names it.
        location: Where in the data.
        value: What was given there.
        words: What is wrong, in pydantic's or the validator's words.
        limits: What the words speak of, e.g. ``{"ge": 1}``.
        known: Keys that are allowed where one is not.
    """

    kind: str
    location: Location
    value: object
    words: str
    limits: Mapping[str, object]
    known: tuple[str, ...]

    @property
    def field(self) -> str:
        """The location as text."""
        return field_name(self.location)

    @property
    def sentence(self) -> str:
        """Description of the fault, with the value and the nearest right name."""
        return self.told(quoted_text)

    def told(self, quote: Callable[[str], str]) -> str:
        """Describe the fault, with the value quoted by a function, and the nearest valid name."""
        hint = nearest(str(self.location[-1]), self.known) if self.known else ""
        value = self.value
        if isinstance(value, (int, float, str, bool)) and repr(value) not in self.words:
            shown = quote(value) if isinstance(value, str) else repr(value)
            return f"{shown}: {self.words}{hint}"
        return f"{self.words}{hint}"


def package_file(package: str, relative: str) -> Path:
    """Path of a data file shipped inside a Python package.

    Raises:
        ConfigError: There is no such file.
    """
    path = Path(str(importlib.resources.files(package))) / relative
    if not path.is_file():
        raise ConfigError(f"package {package} ships no file '{relative}'", package=package, file=relative)
    return path


def load_model(
    path: str | Path,
    model: type[ModelT],
    *,
    within: Sequence[str | Path] = (),
    plain: Callable[[str], str] = lambda text: text,
) -> ModelT:
    """Read a YAML file into a model.

    Args:
        path: The file.
        model: The pydantic model it must satisfy.
        within: Folders that the opened file must lie in; empty: it may lie anywhere.
        plain: Makes YAML of the text, line by line.

    Raises:
        ConfigError: The file is missing, lies outside of the folders, is not YAML, or breaks a rule of the model; one
            line a fault, each ``file:line: field: what is wrong``.
    """
    path = Path(path)
    return cast(ModelT, _read(plain(_text(path, within)), model, str(path)))


@lru_cache(maxsize=16)
def _read(text: str, model: type[pydantic.BaseModel], name: str) -> pydantic.BaseModel:
    """Parse a file once for several nodes of a process, and for processes begun as copies; models are frozen."""
    return parse_model(text, model, name)


def parse_model(text: str, model: type[ModelT], name: str) -> ModelT:
    """As :func:`load_model`, from text; ``name`` is the file in errors, and in the context of validators."""
    try:
        root = read_yaml(text, name)
        data = as_data(root)
    except RepeatedKeyError as error:
        raise _config_error(model, (error.place, (*error.location, error.place.text), "given twice")) from error
    except YamlError as error:
        raise _config_error(model, (error.place, error.location, error.sentence)) from error
    try:
        checked = model.model_validate(data, context={"file": name})
    except pydantic.ValidationError as error:
        told = ((find(root, fault.location).value, fault.location, fault) for fault in faults(error, model))
        raise _config_error(model, *told) from error
    if wrong := list(_truths_for_numbers(data, checked, ())):
        raise _config_error(model, *((find(root, place).value, place, sentence) for place, sentence in wrong))
    return checked


def _truths_for_numbers(given: object, checked: object, location: Location) -> Iterator[tuple[Location, str]]:
    """Yield where a file has true or false for a number, which pydantic takes for 1 or 0."""
    if isinstance(given, bool):
        if isinstance(checked, int | float) and not isinstance(checked, bool):
            yield location, f"{str(given).lower()}: a number is needed"
    elif isinstance(given, Mapping):
        names = {each.alias or name: name for name, each in getattr(type(checked), "model_fields", {}).items()}
        for key, value in given.items():
            below = checked.get(key) if isinstance(checked, Mapping) else getattr(checked, names.get(key, ""), None)
            yield from _truths_for_numbers(value, below, (*location, key))
    elif isinstance(given, list) and isinstance(checked, list | tuple) and len(given) == len(checked):
        for rank, (value, below) in enumerate(zip(given, checked, strict=True)):
            yield from _truths_for_numbers(value, below, (*location, rank))


def fault_in(path: Path, location: Location, sentence: str) -> ConfigError:
    """Return the error for a field of a readable YAML file, about a fault beyond the model's own checks."""
    return _config_error(None, (find(read_yaml(_text(path), str(path)), location).value, location, sentence))


def faults(error: pydantic.ValidationError, model: type[pydantic.BaseModel]) -> list[Fault]:
    """Return the faults found by a model; of very many faults only the first, because each takes time to place."""
    told: list[Fault] = []
    for each in error.errors(include_url=False)[:_MOST_FAULTS]:
        context = each.get("ctx", {})
        below: Location = getattr(context.get("error"), "location", ())
        known = _keys(model, each["loc"][:-1]) if each["type"] == "extra_forbidden" else ()
        words = each["msg"].removeprefix("Value error, ")
        for name, said in context.items():
            if isinstance(said, str) and name != "expected":  # such as the tag of a union, which the file has chosen
                words = words.replace(said, shortened(said))
        if each["type"] in ("model_type", "dict_type"):  # pydantic names the class of the model
            words = "a mapping (key: value) is needed"
        told.append(Fault(each["type"], (*each["loc"], *below), each["input"], words, context, known))
    # pydantic leaves wrong elements out, and then finds the list too short
    wrong = {fault.location[:end] for fault in told for end in range(len(fault.location))}
    return [fault for fault in told if not (fault.kind == "too_short" and fault.location in wrong)]


def field_name(location: Location) -> str:
    """Return ``("slots", 3, "limits")`` as ``slots[3].limits``."""
    text = ""
    for key in location:
        text += f"[{key}]" if isinstance(key, int) else f".{shortened(key)}" if text else shortened(key)
    return text


def _text(path: Path, within: Sequence[str | Path] = ()) -> str:
    try:
        return read_text(path, _LARGEST_YAML, within=within)
    except FileError as error:
        raise ConfigError(error.message, file=str(path)) from error


def _config_error(model: type[pydantic.BaseModel] | None, *told: tuple[Value, Location, "str | Fault"]) -> ConfigError:
    """Build the error for faults at some places, a line each; the facts are the facts of the first.

    Args:
        model: The model of the file, whose own keys are told in full; None: all keys are.
        told: Place, location, and what is wrong there.
    """
    lines, quote = [], Quotation()
    for place, location, wrong in told:
        field = f"{_shown_field(location, model, quote)}: " if location else ""
        sentence = wrong if isinstance(wrong, str) else wrong.told(quote)
        lines.append(f"{place.file}:{place.line}: {field}{sentence}")
    first, location, _ = told[0]
    field = field_name(location)
    return ConfigError("\n".join(lines), file=first.file, line=first.line, column=first.column, field=field)


def _shown_field(location: Location, model: type[pydantic.BaseModel] | None, quote: Quotation) -> str:
    """Format a location as text; keys chosen by the file are quoted within the limit of the error."""
    if model is None:
        return field_name(location)
    own = (isinstance(part, int) or part in _keys(model, location[:at]) for at, part in enumerate(location))
    return field_name(tuple(part if known else quote.cut(str(part)) for part, known in zip(location, own, strict=True)))


def _keys(model: type[pydantic.BaseModel], location: Location) -> tuple[str, ...]:
    """Return the keys of the models at a location; none at a location without a model."""
    annotations: list[object] = [model]
    for part in location:
        annotations = [below for annotation in annotations for below in _below(annotation, part)]
    return tuple(
        field.alias or name
        for annotation in annotations
        for each in _choices(annotation)
        if isinstance(each, type) and issubclass(each, pydantic.BaseModel)
        for name, field in each.model_fields.items()
    )


def _choices(annotation: object) -> list[object]:
    """Return the types allowed by an annotation: the members of a union."""
    if get_origin(annotation) is Annotated:
        return _choices(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return [each for member in get_args(annotation) for each in _choices(member)]
    return [annotation]


def _below(annotation: object, part: int | str) -> list[object]:
    """Return the annotations of the values under a key or index."""
    found: list[object] = []
    for each in _choices(annotation):
        if isinstance(each, type) and issubclass(each, pydantic.BaseModel):
            found += [f.annotation for name, f in each.model_fields.items() if part in (name, f.alias)]
        elif arguments := [argument for argument in get_args(each) if argument is not Ellipsis]:
            found += arguments[-1:]
    return found
