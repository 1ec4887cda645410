"""Messages of a program beside the work (starting, recording): a missing reader changes nothing."""

import sys
from contextlib import suppress
from typing import TextIO


def say(sentence: str) -> None:
    """Print a message; a closed pipe (``start | head -1``) or a log on a full disk does not stop the start."""
    _write(sys.stdout, sentence)


def complain(sentence: str) -> None:
    """Print a complaint; safe like :func:`say`."""
    _write(sys.stderr, sentence)


def _write(stream: TextIO | None, sentence: str) -> None:
    if stream is None or stream.closed:  # None: it was closed when the program began
        return
    try:
        print(sentence, file=stream, flush=True)
    except OSError:
        with suppress(OSError):
            stream.close()  # else the interpreter would try again at its end, and call the program a failure
