"""What the commands of the calibration have in common: how they are told, and how they end."""

import argparse
import sys
from collections.abc import Callable

from im_core.errors import ImError
from im_core.options import NumberParser

OK, BAD_INPUT, INTERRUPTED = 0, 1, 130


def parser(name: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """A parser of arguments whose help shows `epilog` as it is written."""
    return NumberParser(
        prog=name, description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def run(name: str, work: Callable[[], None]) -> int:
    """Do the work of a command; what cannot be done is said in a sentence.

    Args:
        name: Of the command.
        work: What it does.

    Returns:
        The exit code.
    """
    try:
        work()
    except ImError as error:
        print(f"{name}: {error.message}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        return INTERRUPTED
    return OK
