"""The only place to read the wall clock; all waiting is done here."""

import time
from datetime import UTC, datetime

monotonic = time.monotonic
"""Seconds of a clock that never goes back [s]; the function itself, for it is called at every firing."""


def wall() -> float:
    """Seconds since 1970 [s]."""
    return time.time()


def utc(later_s: float = 0.0) -> datetime:
    """Return the present time, or a later one, in UTC.

    Args:
        later_s: How much later [s].
    """
    return datetime.fromtimestamp(wall() + later_s, UTC)


def cpu() -> float:
    """Return the CPU time used by the process, in all threads [s]."""
    return time.process_time()


thread_cpu = time.thread_time
"""CPU time that the calling thread has used [s]: what only computes is limited by it, and is late on a busy computer
instead of failing."""


def stamp_name() -> str:
    """The present local date and time as a name for a folder, e.g. ``20260131-142501``."""
    return time.strftime("%Y%m%d-%H%M%S")


def sleep(seconds: float) -> None:
    """Sleep; returns at once if ``seconds`` is not positive [s]."""
    if seconds > 0.0:
        time.sleep(seconds)


def sleep_until(deadline: float) -> float:
    """Sleep until an absolute time of :func:`monotonic`.

    Args:
        deadline: Absolute time [s].

    Returns:
        How late it is on return [s], at least 0.
    """
    sleep(deadline - monotonic())
    return max(0.0, monotonic() - deadline)
