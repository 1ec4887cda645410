"""End signals of a process, and the two ways to handle the signals."""

import os
import signal
import threading
from collections.abc import Callable
from types import FrameType

#: Ctrl-C, the usual request to end, and the closing of the terminal.
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def heed_end_signals(act: Callable[[signal.Signals], object]) -> None:
    """Call a function for every end signal, in a thread of its own and at once; from the main thread.

    A handler of Python runs between two instructions of the main thread, which may hold the lock that the handler
    wants, and does not run while the main thread waits in C. A function in another thread may set events and complete
    futures.
    """

    def act_on_end(number: int) -> None:
        if number in END_SIGNALS:
            act(signal.Signals(number))

    signal.set_wakeup_fd(signal_pipe(act_on_end), warn_on_full_buffer=False)
    handle_end_signals(no_action)


def signal_pipe(act: Callable[[int], object]) -> int:
    """Return a file descriptor for ``signal.set_wakeup_fd``; a thread calls a function for each signal written there.

    The thread ends when the descriptor is closed.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def watch() -> None:
        while numbers := os.read(reading, 64):
            for number in numbers:
                act(number)
        os.close(reading)

    threading.Thread(target=watch, name="signals", daemon=True).start()
    return writing


def handle_end_signals(handler: Callable[[int, FrameType | None], object]) -> None:
    """Install a handler of the main thread for every end signal, for handlers that raise or only note the signal.

    SIGHUP stays ignored where it was ignored from the beginning: ``nohup`` lets a program outlive its terminal. SIGINT
    does not: a shell ignores it for what it starts in the background.

    Args:
        handler: Takes the signal's number and the frame that it interrupts.
    """
    for number in END_SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def no_action(number: int, frame: FrameType | None) -> None:
    """Do nothing: a handler for signals that a thread or nobody is to act on."""


def _end_by_signals() -> None:
    """Let end signals end a copy of the process, until the copy heeds the signals itself."""
    if signal.getsignal(signal.SIGTERM) is no_action:
        signal.set_wakeup_fd(-1)
        handle_end_signals(signal.SIG_DFL)  # type: ignore[arg-type]  # the default is no function


os.register_at_fork(after_in_child=_end_by_signals)
