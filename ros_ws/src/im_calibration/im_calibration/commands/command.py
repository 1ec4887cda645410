"""Common parts of the calibration's commands: messages and exit codes."""

import argparse
import sys
from collections.abc import Callable

from im_core.errors import ImError
from im_core.options import NumberParser

OK, BAD_INPUT, INTERRUPTED = 0, 1, 130


def parser(name: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return a parser of arguments; the help shows `epilog` as written."""
    return NumberParser(
        prog=name, description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def run(name: str, work: Callable[[], None]) -> int:
    """Run a command; report a failure in one sentence.

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
