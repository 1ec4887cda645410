"""End signals of a process, and the one way to handle the signals."""

import signal
from collections.abc import Callable
from types import FrameType

#: Ctrl-C, the usual request to end, and the closing of the terminal.
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def heed_end_signals(handler: Callable[[int, FrameType | None], object]) -> None:
    """Call a handler for every end signal.

    SIGHUP stays ignored where it was ignored from the beginning: ``nohup`` lets a program outlive its terminal. SIGINT
    does not: a shell ignores it for what it starts in the background.

    Args:
        handler: Takes the signal's number and the frame that it interrupts.
    """
    for number in END_SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)
