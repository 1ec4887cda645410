"""Handling of end signals in commands with cleanup to do before the end."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from im_core.processes.end_signals import END_SIGNALS, handle_end_signals, no_action


def interrupt_once() -> None:
    """Let the first end signal raise KeyboardInterrupt, and ignore all following ones.

    Ctrl-C in a terminal reaches a script and its child, and the script passes it on: without this the second one
    would cut the cleaning up short. It also works where a shell started the command in the background, which ignores
    SIGINT. A second call lets one more signal interrupt; the signals before that call stay ignored.
    """
    signal.pthread_sigmask(signal.SIG_UNBLOCK, END_SIGNALS)
    handle_end_signals(_raise)


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Delay KeyboardInterrupt to the end of the block: work begun in the block is recorded fully or not begun.

    Raises:
        KeyboardInterrupt: A signal that asks to end came within the block.
    """
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in END_SIGNALS}
    handle_end_signals(lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        _raise(came[0])


def ignore_interrupts() -> None:
    """Ignore interrupts until the end of the command; for commands of at most a few seconds."""
    for number in END_SIGNALS:
        signal.signal(number, no_action)  # not yet SIG_IGN: Python complains of a signal that came just before
    signal.raise_signal(signal.SIGINT)  # in a handler: has Python call those of signals that came together with its own
    signal.pthread_sigmask(signal.SIG_BLOCK, END_SIGNALS)
    for number in END_SIGNALS:  # handlers are gone while the interpreter ends, and threads of libraries block nothing
        signal.signal(number, signal.SIG_IGN)


def _raise(number: int, frame: FrameType | None = None) -> NoReturn:
    ignore_interrupts()
    raise KeyboardInterrupt
