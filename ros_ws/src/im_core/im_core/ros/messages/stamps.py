"""Stamps of messages."""

from builtin_interfaces.msg import Time

from im_core import clock


def to_stamp(nanoseconds: int) -> Time:
    """Return a stamp from nanoseconds."""
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def wall_stamp() -> Time:
    """Return the stamp of the present wall time."""
    return to_stamp(int(clock.wall() * 1e9))
