"""What a program says beside its work, as starting a machine or recording: whether anybody hears it changes nothing."""

import sys
from contextlib import suppress
from typing import TextIO


def say(sentence: str) -> None:
    """Say something, to whoever listens: ``start | head -1``, or into a log on a full disk, starts the machine."""
    _write(sys.stdout, sentence)


def complain(sentence: str) -> None:
    """Say what is wrong; likewise."""
    _write(sys.stderr, sentence)


def _write(stream: TextIO | None, sentence: str) -> None:
    if stream is None or stream.closed:  # None: it was closed when the program began
        return
    try:
        print(sentence, file=stream, flush=True)
    except OSError:
        with suppress(OSError):
            stream.close()  # else the interpreter would try again at its end, and call the program a failure
