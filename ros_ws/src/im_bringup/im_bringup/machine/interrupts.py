"""SIGINT and SIGTERM in commands that have something to put away before they end."""

import signal
from types import FrameType
from typing import NoReturn

_NUMBERS = (signal.SIGINT, signal.SIGTERM)


def interrupt_once() -> None:
    """Let the first SIGINT or SIGTERM raise KeyboardInterrupt, and ignore those that follow.

    Ctrl-C in a terminal reaches a script and its child, and the script passes it on: without this the second one
    would cut the cleaning up short. It also works where a shell started the command in the background, which ignores
    SIGINT.
    """
    for number in _NUMBERS:
        signal.signal(number, _raise)


def ignore_interrupts() -> None:
    """Finish, whatever comes; for commands that take a few seconds at most."""
    for number in _NUMBERS:
        signal.signal(number, _nothing)  # not SIG_IGN: Python complains of a signal that came just before
    signal.pthread_sigmask(signal.SIG_BLOCK, _NUMBERS)  # also while the interpreter ends, when handlers are gone


def _nothing(number: int, frame: FrameType | None) -> None:
    pass


def _raise(number: int, frame: FrameType | None) -> NoReturn:
    ignore_interrupts()
    raise KeyboardInterrupt
