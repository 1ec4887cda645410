"""Straight lines in SE(3) through poses, corners rounded where wanted."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray


@dataclass(frozen=True)
class PathPlace:
    """One place of a path; derivatives are by the path parameter [1/m].

    Attributes:
        pose: Of the wrist in ``world``.
        twist: Derivative of the pose along the axes of ``world``, shape (6,): linear, angular.
        twist_rate: Its derivative, shape (6,).
        carriers: Positions of the joints that carry the arm, shape (3, c): value, first and second derivative.
    """

    pose: pin.SE3
    twist: NDArray[np.float64]
    twist_rate: NDArray[np.float64]
    carriers: NDArray[np.float64]


class LinePath:
    """Straight line from pose to pose: the position moves evenly, the rotation about a fixed axis (slerp).

    The path parameter of a line is its length, or that of its rotation where this is longer. A rounded corner mixes
    the directions of both lines, its parameter within ``blend`` of the corner on either side: continuous to the second
    derivative, nowhere faster than the lines, nowhere farther than ``blend`` from the corner.

    Attributes:
        corners: Path parameter of every pose, from 0 [m].
        edges: Path parameters at which one polynomial follows the other, corners that are not rounded included.
        rounded: Begin and end of every rounded corner [m].
        lengths: Length of the way of the wrist's origin on each line [m].
        poses: Poses passed, the first is where the path begins.

    Args:
        poses: Where the path begins, and one pose or more; no two consecutive ones equal.
        carriers: Positions of the joints that carry the arm at each pose, shape (m + 1, c) [rad or m].
        blend: Within this of a corner it may be rounded [m].
        lever: Way that a rotation of one radian counts as [m].
    """

    def __init__(self, poses: Sequence[pin.SE3], carriers: NDArray[np.float64], blend: float, lever: float) -> None:
        self.poses = list(poses)
        self._carriers = carriers
        moves = [b.translation - a.translation for a, b in pairwise(poses)]
        turns = [pin.log3(b.rotation @ a.rotation.T) for a, b in pairwise(poses)]
        self.lengths = [float(np.linalg.norm(move)) for move in moves]
        sizes = [parameter_length(a, b, lever) for a, b in pairwise(poses)]
        self.corners = list(accumulate(sizes, initial=0.0))
        self._twists = [np.concatenate([m, t]) / size for m, t, size in zip(moves, turns, sizes, strict=True)]
        self._slopes = [step / size for step, size in zip(np.diff(carriers, axis=0), sizes, strict=True)]
        inner = [min(blend, a / 2.0, b / 2.0) for a, b in pairwise(sizes)]
        self._blends = [0.0, *inner, 0.0]
        around = ([s - b, s + b] if b > 0.0 else [s] for s, b in zip(self.corners, self._blends, strict=True))
        self.edges = sorted({s for pair in around for s in pair})
        self.rounded = [(s - b, s + b) for s, b in zip(self.corners, self._blends, strict=True) if b > 0.0]

    @property
    def size(self) -> float:
        """Path parameter at the end [m]."""
        return self.corners[-1]

    def line(self, s: float) -> int:
        """Index of the line at path parameter ``s`` [m]."""
        return min(max(bisect.bisect_right(self.corners, s) - 1, 0), len(self._twists) - 1)

    def lines(self, s: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return indices of the lines at path parameters ``s``, shape (m,) [m]."""
        return np.asarray(np.clip(np.searchsorted(self.corners, s, side="right") - 1, 0, len(self._twists) - 1))

    def at(self, s: float) -> PathPlace:
        """The place at path parameter ``s``, 0 to ``size`` [m]."""
        k = self.line(s)
        if s - self.corners[k] < self._blends[k]:
            return self._rounded(k, s - self.corners[k])
        if self.corners[k + 1] - s < self._blends[k + 1]:
            return self._rounded(k + 1, s - self.corners[k + 1])
        u, twist, slope = s - self.corners[k], self._twists[k], self._slopes[k]
        start = self.poses[k]
        pose = pin.SE3(pin.exp3(twist[3:] * u) @ start.rotation, start.translation + twist[:3] * u)
        carriers = np.stack([self._carriers[k] + slope * u, slope, np.zeros_like(slope)])
        return PathPlace(pose, twist, np.zeros(6), carriers)

    def _rounded(self, k: int, u: float) -> PathPlace:
        """Return a place near corner ``k``, ``u`` after the corner: one line fades out as the next line fades in."""
        blend = self._blends[k]
        y = (u / blend + 1.0) / 2.0
        after, rate, bend = blend * y**3 * (2.0 - y), y * y * (3.0 - 2.0 * y), 3.0 * y * (1.0 - y) / blend
        before = u - after
        t0, t1 = self._twists[k - 1], self._twists[k]
        corner = self.poses[k]
        turn = pin.exp3(t1[3:] * after)
        omega = turn @ t0[3:]
        pose = pin.SE3(
            turn @ pin.exp3(t0[3:] * before) @ corner.rotation, corner.translation + t0[:3] * before + t1[:3] * after
        )
        twist = np.concatenate([t0[:3] * (1.0 - rate) + t1[:3] * rate, omega * (1.0 - rate) + t1[3:] * rate])
        swing = np.cross(t1[3:], omega) * rate * (1.0 - rate)
        twist_rate = np.concatenate([(t1[:3] - t0[:3]) * bend, (t1[3:] - omega) * bend + swing])
        c0, c1 = self._slopes[k - 1], self._slopes[k]
        carriers = np.stack(
            [self._carriers[k] + c0 * before + c1 * after, c0 * (1.0 - rate) + c1 * rate, (c1 - c0) * bend]
        )
        return PathPlace(pose, twist, twist_rate, carriers)


class CarriedPath(LinePath):
    """Path of what keeps its pose to a wrist on a straight line.

    Args:
        poses: Of the wrist, as of :class:`LinePath`.
        carriers: Positions of the joints that carry the arm of what is carried, likewise.
        blend: As of :class:`LinePath` [m].
        lever: As of :class:`LinePath` [m].
        relative: Its pose in the frame of the wrist.
    """

    def __init__(
        self, poses: Sequence[pin.SE3], carriers: NDArray[np.float64], blend: float, lever: float, relative: pin.SE3
    ) -> None:
        super().__init__(poses, carriers, blend, lever)
        self._relative = relative

    def at(self, s: float) -> PathPlace:
        """The place at path parameter ``s``, 0 to ``size`` [m]."""
        place = super().at(s)
        pose, omega, alpha = place.pose * self._relative, place.twist[3:], place.twist_rate[3:]
        arm = pose.translation - place.pose.translation
        swing = np.cross(omega, arm)
        twist, twist_rate = place.twist.copy(), place.twist_rate.copy()
        twist[:3] += swing
        twist_rate[:3] += np.cross(alpha, arm) + np.cross(omega, swing)
        return PathPlace(pose, twist, twist_rate, place.carriers)


def parameter_length(a: pin.SE3, b: pin.SE3, lever: float) -> float:
    """Size of the path parameter from one pose to another [m].

    Args:
        a: One pose.
        b: The other.
        lever: Way that a rotation of one radian counts as [m].
    """
    way = float(np.linalg.norm(b.translation - a.translation))
    return max(way, lever * float(np.linalg.norm(pin.log3(b.rotation @ a.rotation.T))))
