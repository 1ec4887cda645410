"""Bound the destruction of nodes: with the last one, a process may hang for ever.

- Upstream: the destruction of a participant waits for a discovery callback under way, and keeps the lock that the
  callback needs: the time-out, "never", overflows into the past, for which the C library gives no lock back. The
  interpreter's lock is held, too: neither a signal nor a thread of Python can help, and a core is busy.
- Issue: https://github.com/eProsima/Fast-DDS/issues/6513, open.
- Seen: Fast DDS 2.14 (Jazzy), where two processes ended at once.
- Test: the fault is a race and cannot be shown at will; ``test_a_destruction_that_hangs_ends_the_process`` in
  ``test/test_rclpy_fixes.py`` shows the bound.
"""

import faulthandler
from collections.abc import Iterator
from contextlib import contextmanager

LONGEST_S = 30.0
"""Longest destruction; a usual one takes milliseconds [s]."""
_STANDARD_ERROR = 2


@contextmanager
def bounded_end() -> Iterator[None]:
    """End the process with exit code 1, and print where it hangs, if the block takes too long."""
    faulthandler.dump_traceback_later(LONGEST_S, exit=True, file=_STANDARD_ERROR)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
