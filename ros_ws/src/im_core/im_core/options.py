"""Numbers on a command line: a parser, and the ``type`` functions of argparse with the given and allowed values."""

import argparse
import math
import re
from collections.abc import Callable
from typing import Any

#: Longest time that a command may be told to wait [s].
LONGEST_S = 86_400.0
_SHOWN = 60
_NEGATIVE = re.compile(r"-((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf|infinity|nan)$", re.ASCII | re.IGNORECASE)


class NumberParser(argparse.ArgumentParser):
    """Parser with negative numbers as values; argparse takes ``-1e-3``, as printed by Python, for an option.

    Args:
        options: Those of :class:`argparse.ArgumentParser`.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._negative_number_matcher = _NEGATIVE


def finite_number(text: str) -> float:
    """Read a finite number.

    Raises:
        ArgumentTypeError: It is none.
    """
    if not math.isfinite(value := _value(text)):
        raise argparse.ArgumentTypeError(f"{shown(text)} is not a finite number")
    return value


def seconds(text: str) -> float:
    """Read a time to wait [s], above 0 and up to :data:`LONGEST_S`; raises as :func:`finite_number`."""
    if not 0.0 < (value := _value(text)) <= LONGEST_S:
        raise argparse.ArgumentTypeError(f"{shown(text)} is no time between 0 and {LONGEST_S:g} s")
    return value


def computing_seconds(text: str) -> float:
    """Read a computing time [s], above 0; raises as :func:`finite_number`."""
    if not 0.0 < (value := _value(text)) < math.inf:
        raise argparse.ArgumentTypeError(f"{shown(text)} is no time above 0 s")
    return value


def whole(text: str) -> int:
    """Read a whole number.

    Raises:
        ArgumentTypeError: It is none.
    """
    if not re.fullmatch(r"[+-]?\d{1,19}", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{shown(text)} is not a whole number")
    return int(text)


def between(least: int, most: int) -> Callable[[str], int]:
    """Return a reader of whole numbers from ``least`` to ``most``; the reader raises as :func:`whole`."""

    def number_between(text: str) -> int:
        if not least <= (value := whole(text)) <= most:
            raise argparse.ArgumentTypeError(f"{value} is no whole number from {least} to {most}")
        return value

    return number_between


def at_least(least: int) -> Callable[[str], int]:
    """Return a reader of whole numbers not below ``least``; the reader raises as :func:`whole`."""

    def number_from(text: str) -> int:
        if (value := whole(text)) < least:
            raise argparse.ArgumentTypeError(f"{value} is no whole number from {least} on")
        return value

    return number_from


def shown(text: str) -> str:
    """Return the beginning of a text for a message, in quotes where nothing of it would be seen."""
    return text[:_SHOWN] if text.strip() else repr(text[:_SHOWN])


def _value(text: str) -> float:
    """Return the number in a text, NaN for a text without a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan
