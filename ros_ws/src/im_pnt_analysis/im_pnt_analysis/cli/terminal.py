"""Ctrl-C that ends long computations at once, also in the middle of foreign code that keeps Python from noticing."""

import os
import signal
import sys
import threading
from types import TracebackType

INTERRUPTED = 130
"""Exit code."""


class EndOnInterrupt:
    """While this context lasts, Ctrl-C says a word and ends the process; nothing must be half written in it.

    Args:
        word: What to say on stderr.
    """

    def __init__(self, word: str) -> None:
        self._word = word
        self._active = threading.current_thread() is threading.main_thread()

    def __enter__(self) -> None:
        if self._active:
            reading, self._writing = os.pipe()
            os.set_blocking(self._writing, False)
            self._fd_before = signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
            self._handler_before = signal.signal(signal.SIGINT, lambda number, frame: None)
            threading.Thread(target=self._watch, args=(reading,), daemon=True).start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._active:
            signal.signal(signal.SIGINT, self._handler_before)
            signal.set_wakeup_fd(self._fd_before)
            os.close(self._writing)

    def _watch(self, reading: int) -> None:
        while numbers := os.read(reading, 64):
            if signal.SIGINT in numbers:
                print(self._word, file=sys.stderr, flush=True)
                os._exit(INTERRUPTED)
        os.close(reading)
