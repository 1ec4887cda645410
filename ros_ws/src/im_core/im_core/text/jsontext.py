"""JSON files from elsewhere, read in bounded time and memory; :mod:`.bounded_json` reads JSON in messages."""

import json
import math
import re
from contextlib import suppress
from pathlib import Path

from im_core.errors import DataError, printable, require_text
from im_core.files import LARGEST, FileError, read_text

MAX_DEPTH = 40
MAX_VALUES = 5_000_000

_LONGEST_INTEGER = 20
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")


class JsonError(ValueError):
    """Unreadable text.

    Attributes:
        sentence: What is wrong.
        line: Where, from 1; None: nobody knows.
        column: Where in the line, from 1.
    """

    def __init__(self, sentence: str, line: int | None = None, column: int | None = None) -> None:
        super().__init__(sentence)
        self.sentence, self.line, self.column = sentence, line, column


def load_json(path: str | Path, largest: int = LARGEST) -> object:
    """Read a JSON file.

    Args:
        path: The file.
        largest: What it may have at most [bytes].

    Raises:
        FileError: It cannot be read, or :func:`decode_json` refuses it.
    """
    text = read_text(path, largest)
    try:
        return decode_json(text)
    except JsonError as error:
        raise FileError(path, error.sentence, error.line, error.column) from error


def decode_json(text: str) -> object:
    """Decode JSON; a whole number of more than 20 digits is a float.

    Raises:
        JsonError: Not JSON, a key twice in an object, a number that is not finite, text that is no Unicode, or more
            values or deeper nesting than data can need.
    """
    # every value but the first follows a comma or a bracket; counted before the objects are made, which are larger
    if text.count(",") + text.count("[") + text.count("{") >= MAX_VALUES:
        raise JsonError(f"more than {MAX_VALUES} values, the most allowed")
    try:
        data: object = json.loads(
            text, parse_int=_integer, parse_float=_float, parse_constant=_no_number, object_pairs_hook=_object
        )
    except json.JSONDecodeError as error:
        raise JsonError(f"not JSON: {error.msg}", error.lineno, error.colno) from error
    except RecursionError as error:
        raise JsonError(f"values nest deeper than {MAX_DEPTH}") from error
    _check_depth(data)
    if _SURROGATE.search(text) or not text.isascii():
        _check_unicode(data)
    return data


def check_keys(text: str) -> None:
    """Refuse a duplicate key in an object of a JSON text; a text without valid JSON is left to the reader.

    Raises:
        JsonError: One is.
    """
    with suppress(json.JSONDecodeError, RecursionError):
        # int() refuses numbers of thousands of digits
        json.loads(text, parse_int=str, parse_float=str, object_pairs_hook=_object)


def _integer(text: str) -> int | float:
    return int(text) if len(text) <= _LONGEST_INTEGER else _float(text)


def _float(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise JsonError(f"the number {text[:40]} is too large")
    return number


def _no_number(name: str) -> float:
    raise JsonError(f"{name} is not a number of JSON")


def _object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    data = dict(pairs)
    if len(data) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise JsonError(f"the key '{printable(twice)[:60]}' is there twice")
    return data


def _check_depth(data: object) -> None:
    level, depth = [data], 0
    while level := [each for each in level if isinstance(each, (list, dict))]:
        depth += 1
        if depth > MAX_DEPTH:
            raise JsonError(f"values nest deeper than {MAX_DEPTH}")
        level = [child for each in level for child in (each.values() if isinstance(each, dict) else each)]


def _check_unicode(data: object) -> None:
    try:
        require_text(json.dumps(data, ensure_ascii=False), "text")
    except DataError as error:
        raise JsonError(error.message) from error
