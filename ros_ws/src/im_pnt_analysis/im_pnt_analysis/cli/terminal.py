"""Shared parts of the commands of ``pnt``: exit codes, sensible numbers, output files, and Ctrl-C."""

import argparse
import os
import signal
import sys
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from im_core.clock import monotonic
from im_core.errors import ImError
from im_core.files import write_whole
from im_core.processes.end_signals import no_action, signal_pipe
from im_pnt.model.net import Net

OK, REFUSED, BAD_INPUT, UNPROVED = 0, 1, 2, 3


def refuse_without_effect(options: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """Refuse options without an effect.

    Args:
        options: All options; those that were not given are None or False.
        names: As the user writes them.
        why: Why they would have no effect, as in "with --replay".

    Raises:
        ImError: One of them was given.
    """
    for name in names:
        given = getattr(options, name.removeprefix("--"))
        if given is not None and given is not False:
            raise ImError(f"{name} has no effect {why}", code="input")


def write_output(path: Path, text: str, *, overwrite: bool) -> None:
    """Write a text file in one step: a reader sees the old one or the new one.

    Raises:
        ImError: It is there already, or cannot be written.
    """
    if not overwrite and (path.exists() or path.is_symlink()):
        raise ImError(f"'{path}' is there already; --force overwrites it", code="input")
    try:
        write_whole(path, text)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ImError(f"cannot write '{path}': {reason}", code="input") from error


def titles(nets: Sequence[Net]) -> dict[str, str]:
    """Return the names for people of places and transitions, by the names in the composition of nets."""
    found: dict[str, str] = {}
    for net in nets:
        before = "" if len(nets) == 1 else f"{net.name}."
        found |= {f"{before}{place.name}": place.title for place in net.places.values() if place.title}
        found |= {f"{before}{t.name}": t.title for t in net.transitions.values() if t.title}
    return found


_QUIET_S, _EVERY_S = 2.0, 0.5


class ProgressLine:
    """Context with a line of progress on the terminal, removed at the end; nothing in a file."""

    def __init__(self) -> None:
        self._begin = self._last = monotonic()
        self._terminal, self._shown = sys.stderr.isatty(), False

    def __call__(self, text: str) -> None:
        """Show a text after a quiet time, if the last one was shown long enough."""
        now = monotonic()
        if self._terminal and now - self._begin >= _QUIET_S and now - self._last >= _EVERY_S:
            print(f"\r\033[K{now - self._begin:4.0f} s  {text}", end="", file=sys.stderr, flush=True)
            self._last, self._shown = now, True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


INTERRUPTED = 130
"""Exit code."""


class EndOnInterrupt:
    """Context for Ctrl-C to print a word and end the process; nothing may be half written inside."""

    def __init__(self, word: str) -> None:
        self._word = word
        self._active = threading.current_thread() is threading.main_thread()

    def __enter__(self) -> None:
        if self._active:
            self._writing = signal_pipe(self._act)
            self._fd_before = signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
            self._handler_before = signal.signal(signal.SIGINT, no_action)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._active:
            signal.signal(signal.SIGINT, self._handler_before)
            signal.set_wakeup_fd(self._fd_before)
            os.close(self._writing)

    def _act(self, number: int) -> None:
        if number == signal.SIGINT:
            try:
                print(self._word, file=sys.stderr, flush=True)
            finally:  # also where nobody can be told
                os._exit(INTERRUPTED)
