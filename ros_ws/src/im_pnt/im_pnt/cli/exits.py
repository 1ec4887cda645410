"""What the commands of ``pnt`` share: exit codes, the place where they hang, numbers that make sense."""

import argparse
from typing import TYPE_CHECKING

OK, REFUSED, BAD_INPUT = 0, 1, 2

if TYPE_CHECKING:
    Subcommands = argparse._SubParsersAction[argparse.ArgumentParser]
else:
    Subcommands = object


def seconds(text: str) -> float:
    """Reads a time of more than nothing [s], for argparse.

    Raises:
        argparse.ArgumentTypeError: It is none.
    """
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a time > 0 s")
    return value


def count(text: str) -> int:
    """Reads a number of 1 or more, for argparse.

    Raises:
        argparse.ArgumentTypeError: It is none.
    """
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a number >= 1")
    return value
