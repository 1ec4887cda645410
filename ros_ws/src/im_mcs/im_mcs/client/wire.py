"""``trajectory_msgs/JointTrajectory`` and goals of ``FollowJointTrajectory``, read from the bytes (CDR).

A message of 100,000 points takes seconds to become objects, and holds every thread of Python up meanwhile; read as
arrays it takes a hundredth of that. How long a message is stands at its begin: one that is too long costs nothing.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.client.trajectory import GoalTolerances, TimedTrajectory, Tolerance
from im_mcs.protocol.requests import LONGEST_TEXT

_MOST_NAMES = 100
_ENCODINGS = {b"\x00\x01": "<", b"\x00\x00": ">"}
_FIELDS = ("positions", "velocities", "accelerations", "efforts")
_NAMES = ("position", "velocity", "acceleration")
_LEAST_POINT = 24
"""Bytes of a point without any values."""

UUID_BYTES = 16
"""A request for a goal begins with the goal's number."""


class CdrReader:
    """Reader of CDR, one value after the other.

    Args:
        data: All bytes, with the four that say how they are encoded.
        skip: How many bytes after those are not of interest.

    Raises:
        DataError: It is no plain CDR.
    """

    def __init__(self, data: bytes, skip: int = 0) -> None:
        order = _ENCODINGS.get(data[:2])
        if order is None:
            raise DataError(f"{data[:4]!r} ({len(data)} bytes) is not the begin of plain CDR")
        self.data, self.order, self.at = data, order, 4 + skip
        self._u32, self._i32 = (struct.Struct(order + kind).unpack_from for kind in "Ii")

    def count(self) -> int:
        """Read a number from 0 on: the count of following elements."""
        return self._number(self._u32)

    def seconds(self) -> float:
        """Read a time or a duration [s]."""
        whole = self._number(self._i32)
        return float(whole + 1e-9 * self._number(self._u32))

    def text(self) -> str:
        """Read a text of up to 256 bytes."""
        length = self.count()
        if length > LONGEST_TEXT + 1:
            raise DataError(f"a name of {length - 1} bytes is too long; {LONGEST_TEXT} are allowed", bytes=length - 1)
        data = self.data[self.at : self.at + max(length - 1, 0)]
        self.skip(length)
        return data.decode(errors="replace")

    def doubles(self) -> tuple[int, int]:
        """Read begin and length of an array of numbers."""
        count = self.count()
        if count:
            self._align(8)
        begin = self.at
        self.skip(8 * count)
        return begin, count

    def numbers(self, count: int) -> tuple[float, ...]:
        """Read some numbers without an array."""
        self._align(8)
        begin = self.at
        self.skip(8 * count)
        return struct.unpack_from(f"{self.order}{count}d", self.data, begin)

    def skip(self, count: int) -> None:
        """Leave out some bytes.

        Raises:
            DataError: There are not as many.
        """
        self.at += count
        if self.at > len(self.data):
            raise DataError(f"the message ends after {len(self.data)} bytes, in the middle of a value")

    def _number(self, unpack: Callable[[bytes, int], tuple[int]]) -> int:
        self._align(4)
        begin = self.at
        self.skip(4)
        return unpack(self.data, begin)[0]

    def _align(self, size: int) -> None:
        self.at += (4 - self.at) % size


@dataclass(frozen=True)
class TrajectoryHead:
    """Content before the points.

    Attributes:
        start_s: Stamp of the header [s].
        joints: Names.
        points: How many points follow.
    """

    start_s: float
    joints: list[str]
    points: int


def read_head(cdr: CdrReader, most_points: int) -> TrajectoryHead:
    """Read the content before the points, in constant time for any length.

    Raises:
        DataError: Too many points or names, or one that is too long.
    """
    start_s = cdr.seconds()
    cdr.text()
    joints = [cdr.text() for _ in range(_few(cdr.count(), "joint_names"))]
    points = cdr.count()
    check_points(points, most_points)
    if points * _LEAST_POINT > len(cdr.data) - cdr.at + 8:
        raise DataError(f"the message has {len(cdr.data)} bytes, too few for {points} points")
    return TrajectoryHead(start_s, joints, points)


def check_points(points: int, most: int) -> None:
    """Refuse a trajectory with too many points.

    Raises:
        DataError: It has.
    """
    if points > most:
        raise DataError(f"a trajectory of {points} points is too long; {most} are allowed", points=points, most=most)


def read_trajectory(cdr: CdrReader, head: TrajectoryHead) -> TimedTrajectory:
    """Read the points of a trajectory.

    Raises:
        DataError: A point does not have as many values as there are names, or not those that the first has.
    """
    n = len(head.joints)
    if not head.points:
        return TimedTrajectory(head.joints, np.zeros(0), np.zeros((0, n)), start_s=head.start_s)
    times, (q, v, a) = _points(cdr, head.points, n)
    assert q is not None
    return TimedTrajectory(head.joints, times, q, v, a, head.start_s)


def read_tolerances(cdr: CdrReader) -> GoalTolerances:
    """Read the content behind the trajectory of a goal.

    Raises:
        DataError: It has more than tolerances of joints.
    """
    cdr.seconds()
    cdr.text()
    if cdr.count() or cdr.count():
        raise DataError("multi_dof_trajectory is not empty; the joints here have one degree of freedom each")
    found: dict[str, list[Tolerance]] = {}
    for where in ("path", "goal"):
        entries = range(_few(cdr.count(), f"{where}_tolerance"))
        found[where] = [Tolerance(cdr.text(), *cdr.numbers(3)) for _ in entries]
        if cdr.count():
            what = f"component_{where}_tolerance"
            raise DataError(f"{what} is not empty; the joints here have one degree of freedom each")
    return GoalTolerances(found["path"], found["goal"], cdr.seconds())


def _few(count: int, what: str) -> int:
    if count > _MOST_NAMES:
        raise DataError(f"{what} has {count} entries; {_MOST_NAMES} are allowed", entries=count)
    return count


# points


@dataclass(frozen=True)
class _Point:
    """Where the parts of a point are.

    Attributes:
        begin: Of the point.
        lengths: Where the lengths of its arrays stand, for each of them.
        arrays: Where these begin, and how many numbers each has.
        time: Where its time stands.
        end: Behind it.
    """

    begin: int
    lengths: list[int]
    arrays: list[tuple[int, int]]
    time: int
    end: int

    @property
    def sizes(self) -> list[int]:
        return [count for _, count in self.arrays]


def _points(cdr: CdrReader, count: int, n: int) -> tuple[NDArray[np.float64], list[NDArray[np.float64] | None]]:
    """Times, shape (m,), and positions, velocities and accelerations, shape (m, n) each; None where there are none."""
    first = _point(cdr, 1, n)
    parts = [_columns(cdr, first, 0, 1)]
    if count > 1:
        # from the second on all begin at the same place between two multiples of 8, and look alike
        second = _point(cdr, 2, n, first)
        stride = second.end - second.begin
        alike = _alike(cdr, second, stride, count - 1)
        parts.append(_columns(cdr, second, stride, alike))
        cdr.at = second.begin + stride * alike
        for number in range(alike + 2, count + 1):
            _point(cdr, number, n, first)  # the first of them is the one that is wrong
    times = np.concatenate([part[0] for part in parts])
    given = [True, *(bool(size) for size in first.sizes[1 : len(_NAMES)])]
    return times, [np.concatenate([part[1][k] for part in parts]) if there else None for k, there in enumerate(given)]


def _point(cdr: CdrReader, number: int, n: int, like: _Point | None = None) -> _Point:
    begin, lengths, arrays = cdr.at, [], []
    for _ in _FIELDS:
        lengths.append(cdr.at + (4 - cdr.at) % 4)
        arrays.append(cdr.doubles())
    time = cdr.at + (4 - cdr.at) % 4
    cdr.seconds()
    point = _Point(begin, lengths, arrays, time, cdr.at)
    _check_sizes(point.sizes, number, n, point.sizes if like is None else like.sizes)
    return point


def _check_sizes(sizes: list[int], number: int, n: int, like: list[int]) -> None:
    if sizes[3]:
        raise DataError(f"point {number} has efforts; only positions, velocities and accelerations can be followed")
    for name, size in zip(_NAMES, sizes, strict=False):
        if size != n and (size or name == "position"):
            raise DataError(f"point {number}: {name} is given for {size} joints, {n} are needed", point=number)
    for what, size, before in zip(_FIELDS, sizes, like, strict=True):
        if size != before:
            has = f"has {what}, point 1 has none" if size else f"has no {what}, others have"
            raise DataError(f"point {number} {has}; give them for every point or for none", point=number)


def _alike(cdr: CdrReader, point: _Point, stride: int, count: int) -> int:
    """How many points from ``point`` on have arrays of the same sizes."""
    count = min(count, (len(cdr.data) - point.begin) // stride)
    different = np.zeros(count, dtype=np.bool_)
    for place, size in zip(point.lengths, point.sizes, strict=True):
        different |= _strided(cdr, "u4", place, stride, (count,)) != size
    return int(np.argmax(different)) if different.any() else count


def _columns(
    cdr: CdrReader, point: _Point, stride: int, count: int
) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Return times and values of points of the same form."""
    seconds = _strided(cdr, "i4", point.time, stride, (count,))
    nanoseconds = _strided(cdr, "u4", point.time + 4, stride, (count,))
    values = [_strided(cdr, "f8", begin, stride, (count, size)) for begin, size in point.arrays[: len(_NAMES)]]
    return seconds + 1e-9 * nanoseconds, values


def _strided(cdr: CdrReader, kind: str, offset: int, stride: int, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return numbers at every ``stride`` bytes; along the second axis, neighbours."""
    dtype = np.dtype(cdr.order + kind)
    return np.ndarray(shape, dtype, cdr.data, offset, (stride, dtype.itemsize)[: len(shape)])
