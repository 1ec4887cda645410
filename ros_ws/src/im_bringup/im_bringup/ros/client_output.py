"""Standard output and exit codes of a client of the machine."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, TextIO, cast

from im import MachineError
from im_core.errors import ImError, StoreError, WaitTimeoutError
from im_core.output import complain

_OF_RCLPY = (
    "Warning, the number of timers associated with this clock is large.",
    "Management of this number of timers may be inefficient.",
)

LOOKED_FOR_S = 5.0
"""How long a machine is looked for [s]."""
DONE, FAILED, USAGE, NOT_RUNNING, INTERRUPTED = 0, 1, 2, 3, 130


class OwnOutput:
    """Standard output or error of a program, without the rclpy 7.1 warning of each timer beyond eight.

    What cannot be written (a full disk, a reader or a terminal that has gone) ends nothing: the machine is waited for.

    Args:
        stream: Where the rest goes; None: nowhere, it was closed when the program began.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream, self._dropped = stream, False
        self._failure: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, except a warning of rclpy and the separately written end of the warning's line."""
        ends, self._dropped = self._dropped and text == "\n", text in _OF_RCLPY
        if not (ends or self._dropped):
            self._try(lambda stream: stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush the written text out of the process."""
        self._try(lambda stream: stream.flush())

    def check(self) -> None:
        """Raise an error if some text could not be written, except when the reader has gone.

        Raises:
            StoreError: It has not.
        """
        if self._failure is not None and not isinstance(self._failure, BrokenPipeError):
            raise StoreError.of("written", "standard output", self._failure)

    def _try(self, use: Callable[[TextIO], object]) -> None:
        if self._stream is None or self._failure is not None:
            return
        try:
            use(self._stream)
        except OSError as error:
            self._failure = error


@contextlib.contextmanager
def own_output() -> Iterator[None]:
    """Reserve standard output for the program within the context; output of libraries goes to standard error.

    Fast DDS prints its errors, at any time and without being asked.

    Raises:
        StoreError: What the program said could not be written.
    """
    with contextlib.ExitStack() as stack:
        out, given = cast("TextIO | None", sys.stdout), sys.__stdout__
        if given is not None and out is given:  # nobody has put something else in its place
            given.flush()
            number = given.fileno()
            out = os.fdopen(os.dup(number), "w", encoding=given.encoding, errors=given.errors)
            stack.callback(_close, out)
            stack.callback(os.dup2, out.fileno(), number)
            if sys.stderr is not None:
                os.dup2(sys.stderr.fileno(), number)
        own = OwnOutput(out)
        stack.callback(own.flush)
        stack.enter_context(contextlib.redirect_stdout(cast(TextIO, own)))
        stack.enter_context(contextlib.redirect_stderr(cast(TextIO, OwnOutput(sys.stderr))))
        yield
        own.flush()
        own.check()


def _close(stream: TextIO) -> None:
    with contextlib.suppress(OSError):  # it was told already
        stream.close()


def exit_code(do: Callable[[], int], who: str, goes_on: str = "") -> int:
    """Do the work of a client; print the reason of a failure in one sentence; return the exit code.

    Args:
        do: Does it; returns the exit code.
        who: Name of the program, for messages.
        goes_on: What goes on after an interruption, a sentence's second half.
    """
    try:
        return do()
    except KeyboardInterrupt:
        complain(f"{who}: no longer waiting{goes_on}")
        return INTERRUPTED
    except (ImError, MachineError) as error:
        complain(f"{who}: {error.message}")
        return NOT_RUNNING if isinstance(error, WaitTimeoutError) else FAILED
