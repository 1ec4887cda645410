"""Paths of a wrist in SE(3): straight lines and arcs through poses, and of joints; corners rounded where wanted."""

import bisect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.inverse import ArmTracker

# Points of an arc closer to a straight line than this share of their distance have no circle.
_STRAIGHT = 1e-6

SAME_M = 1e-9
"""Poses are one where the path parameter between them is no longer than this [m]."""

Via = NDArray[np.float64] | None
"""Place that an arc passes, shape (3,) [m]; None: the way is straight."""


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


@dataclass(frozen=True)
class _Share:
    """Progress on one leg: ``way`` from the anchoring corner [m], negative before, and two derivatives."""

    leg: int
    way: float
    rate: float
    bend: float


class WristPath(ABC):
    """Path of a wrist: legs between corners, with one path parameter for all moving joints.

    A rounded corner mixes the directions of both legs, its parameter within ``blend`` of the corner on either side:
    continuous to the second derivative, nowhere faster than the legs.

    Attributes:
        corners: Path parameter of every corner, from 0 [m].
        edges: Path parameters at which one polynomial follows the other, corners that are not rounded included.
        rounded: Begin and end of every rounded corner [m].
        sizes: Of the legs [m].
        lengths: Length of the way of the wrist's origin on each leg [m].

    Args:
        sizes: Of the legs [m].
        lengths: As above.
        blend: Within this of a corner it may be rounded [m].
    """

    def __init__(self, sizes: Sequence[float], lengths: Sequence[float], blend: float) -> None:
        self.sizes, self.lengths = list(sizes), list(lengths)
        self.corners = list(accumulate(sizes, initial=0.0))
        inner = [min(blend, a / 2.0, b / 2.0) for a, b in pairwise(sizes)]
        self._blends = [0.0, *inner, 0.0]
        around = ([s - b, s + b] if b > 0.0 else [s] for s, b in zip(self.corners, self._blends, strict=True))
        self.edges = sorted({s for pair in around for s in pair})
        self.rounded = [(s - b, s + b) for s, b in zip(self.corners, self._blends, strict=True) if b > 0.0]

    @abstractmethod
    def at(self, s: float) -> PathPlace:
        """The place at path parameter ``s``, 0 to ``size`` [m]."""

    @abstractmethod
    def named(self, k: int) -> str:
        """Return the kind of a leg, for messages."""

    @property
    def size(self) -> float:
        """Path parameter at the end [m]."""
        return self.corners[-1]

    def leg(self, s: float) -> int:
        """Index of the leg at path parameter ``s`` [m]."""
        return min(max(bisect.bisect_right(self.corners, s) - 1, 0), len(self.corners) - 2)

    def legs(self, s: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return indices of the legs at path parameters ``s``, shape (m,) [m]."""
        return np.asarray(np.clip(np.searchsorted(self.corners, s, side="right") - 1, 0, len(self.corners) - 2))

    def shares(self, s: float) -> tuple[int, list[_Share]]:
        """Return the corner that anchors a place, and the progress on the legs that make it."""
        k = self.leg(s)
        if s - self.corners[k] < self._blends[k]:
            return k, self._rounded(k, s - self.corners[k])
        if self.corners[k + 1] - s < self._blends[k + 1]:
            return k + 1, self._rounded(k + 1, s - self.corners[k + 1])
        return k, [_Share(k, s - self.corners[k], 1.0, 0.0)]

    def mixed(self, s: float, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values that move evenly from corner to corner, shape (m + 1, c), at ``s``: shape (3, c)."""
        anchor, shares = self.shares(s)
        place = np.stack([values[anchor], np.zeros(values.shape[1]), np.zeros(values.shape[1])])
        for share in shares:
            leg = share.leg
            slope = (values[leg + 1] - values[leg]) / self.sizes[leg]
            place += np.outer((share.way, share.rate, share.bend), slope)
        return place

    def _rounded(self, k: int, u: float) -> list[_Share]:
        """Return both legs of corner ``k``, ``u`` after it: one leg fades out as the next leg fades in."""
        blend = self._blends[k]
        y = (u / blend + 1.0) / 2.0
        after, rate, bend = blend * y**3 * (2.0 - y), y * y * (3.0 - 2.0 * y), 3.0 * y * (1.0 - y) / blend
        return [_Share(k - 1, u - after, 1.0 - rate, -bend), _Share(k, after, rate, bend)]


@dataclass(frozen=True)
class _Straight:
    """Even way of a point, over a leg of a size."""

    move: NDArray[np.float64]
    size: float

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return float(np.linalg.norm(self.move))

    def at(self, way: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return displacement from the corner, and two derivatives, each of shape (3,)."""
        slope = self.move / self.size
        return slope * way, slope, np.zeros(3)


@dataclass(frozen=True)
class _Arc:
    """Even way of a point on a circle, over a leg of a size: spokes from the centre to both ends, and the turn."""

    begin: NDArray[np.float64]
    end: NDArray[np.float64]
    turn: NDArray[np.float64]
    size: float

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return float(np.linalg.norm(self.begin) * np.linalg.norm(self.turn))

    def at(self, way: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return displacement from the corner, and two derivatives, each of shape (3,)."""
        spoke = self.end if way < 0.0 else self.begin
        omega = self.turn / self.size
        now = pin.exp3(omega * way) @ spoke
        velocity = np.cross(omega, now)
        return now - spoke, velocity, np.cross(omega, velocity)


class LinePath(WristPath):
    """Straight lines and arcs from pose to pose: the position moves evenly, the rotation about a fixed axis (slerp).

    The path parameter of a leg is its length, or that of its rotation where this is longer. On straight lines a
    rounded corner is nowhere farther than ``blend`` from the corner.

    Args:
        poses: Where the path begins, and one pose or more; no two consecutive ones equal, unless ``sizes`` are given.
        carriers: Positions of the joints that carry the arm at each pose, shape (m + 1, c) [rad or m].
        blend: Within this of a corner it may be rounded [m].
        lever: Way that a rotation of one radian counts as [m].
        vias: Of each leg the place that its arc passes, shape (3,) [m]; None: it is straight. Empty: all are.
        sizes: Sizes of the legs [m]; empty: as above.

    Raises:
        DataError: Three places of an arc are on a straight line.
    """

    def __init__(
        self,
        poses: Sequence[pin.SE3],
        carriers: NDArray[np.float64],
        blend: float,
        lever: float,
        vias: Sequence[Via] = (),
        sizes: Sequence[float] = (),
    ) -> None:
        legs = list(zip(pairwise(poses), vias or [None] * (len(poses) - 1), strict=True))
        sizes = sizes or [parameter_length(a, b, lever, via) for (a, b), via in legs]
        self._poses, self._carriers = list(poses), carriers
        self._ways = [_way(a, b, via, size) for ((a, b), via), size in zip(legs, sizes, strict=True)]
        self._turns = [pin.log3(b.rotation @ a.rotation.T) / n for ((a, b), _), n in zip(legs, sizes, strict=True)]
        super().__init__(sizes, [way.length for way in self._ways], blend)

    def named(self, k: int) -> str:
        """Return the kind of a leg, for messages."""
        return "line to pose" if isinstance(self._ways[k], _Straight) else "arc to pose"

    def at(self, s: float) -> PathPlace:
        """The place at path parameter ``s``, 0 to ``size`` [m]."""
        anchor, shares = self.shares(s)
        translation, rotation = self._poses[anchor].translation.copy(), self._poses[anchor].rotation
        twist, twist_rate = np.zeros(6), np.zeros(6)
        for share in shares:
            moved, velocity, acceleration = self._ways[share.leg].at(share.way)
            translation += moved
            twist[:3] += velocity * share.rate
            twist_rate[:3] += acceleration * share.rate**2 + velocity * share.bend
            turn = self._turns[share.leg]
            step, own = pin.exp3(turn * share.way), turn * share.rate
            rotation, before = step @ rotation, step @ twist[3:]
            twist_rate[3:] = step @ twist_rate[3:] + np.cross(own, before) + turn * share.bend
            twist[3:] = before + own
        return PathPlace(pin.SE3(rotation, translation), twist, twist_rate, self.mixed(s, self._carriers))


class JointWay(WristPath):
    """Path of a wrist whose arm moves straight from point to point in joint space.

    Args:
        tracker: Kinematics of the arm.
        q: Positions of all joints at the begin and at each point, shape (m + 1, n) [rad or m].
        carriers: Positions of the joints that carry another arm, which goes along, shape (m + 1, c) [rad or m].
        blend: Within this of a corner it may be rounded [m].
        sizes: Sizes of the legs [m].
    """

    def __init__(
        self,
        tracker: ArmTracker,
        q: NDArray[np.float64],
        carriers: NDArray[np.float64],
        blend: float,
        sizes: Sequence[float],
    ) -> None:
        super().__init__(sizes, [0.0] * len(sizes), blend)
        self._tracker, self._q, self._carriers = tracker, q, carriers

    def named(self, k: int) -> str:
        """Return the kind of a leg, for messages."""
        return "way to point"

    def joints(self, s: float) -> NDArray[np.float64]:
        """Return positions of all joints and two derivatives at path parameter ``s``, shape (3, n)."""
        return self.mixed(s, self._q)

    def at(self, s: float) -> PathPlace:
        """The place at path parameter ``s``, 0 to ``size`` [m]."""
        return PathPlace(*self._tracker.moved(*self.joints(s)), self.mixed(s, self._carriers))


class CarriedPath(WristPath):
    """Path of a wrist given in the frame of another, moving wrist.

    Args:
        lead: Path of the other wrist in ``world``, with the carriers of this one.
        relative: Path of this one in its frame, with legs of the same sizes.
        blend: Of both [m].
    """

    def __init__(self, lead: WristPath, relative: LinePath, blend: float) -> None:
        super().__init__(lead.sizes, list(map(max, lead.lengths, relative.lengths)), blend)
        self._lead, self._relative = lead, relative

    def named(self, k: int) -> str:
        """Return the kind of a leg, for messages."""
        return self._lead.named(k)

    def at(self, s: float) -> PathPlace:
        """The place at path parameter ``s``, 0 to ``size`` [m]."""
        lead, own = self._lead.at(s), self._relative.at(s)
        omega, alpha, axes = lead.twist[3:], lead.twist_rate[3:], lead.pose.rotation
        arm = axes @ own.pose.translation
        velocity, turn = axes @ own.twist[:3], axes @ own.twist[3:]
        swing = np.cross(omega, arm)
        twist = lead.twist + np.concatenate([swing + velocity, turn])
        swing = np.cross(alpha, arm) + np.cross(omega, swing + 2.0 * velocity) + axes @ own.twist_rate[:3]
        twist_rate = lead.twist_rate + np.concatenate([swing, axes @ own.twist_rate[3:] + np.cross(omega, turn)])
        return PathPlace(lead.pose * own.pose, twist, twist_rate, lead.carriers)


def parameter_length(a: pin.SE3, b: pin.SE3, lever: float, via: Via = None) -> float:
    """Size of the path parameter from one pose to another [m].

    Args:
        a: One pose.
        b: The other.
        lever: Way that a rotation of one radian counts as [m].
        via: Place on the arc between, shape (3,) [m]; None: it is straight.

    Raises:
        DataError: The three places are on a straight line.
    """
    way = _way(a, b, via, 1.0).length
    return max(way, lever * float(np.linalg.norm(pin.log3(b.rotation @ a.rotation.T))))


def _way(a: pin.SE3, b: pin.SE3, via: Via, size: float) -> _Straight | _Arc:
    """Return the way of a wrist's origin from one pose to another."""
    begin, end = a.translation, b.translation
    if via is None:
        return _Straight(end - begin, size)
    first, second = via - begin, end - via
    normal = np.cross(first, second)
    if np.linalg.norm(normal) <= _STRAIGHT * max(np.linalg.norm(first), np.linalg.norm(second)) ** 2:
        places = ", ".join(f"({x:.3f}, {y:.3f}, {z:.3f})" for x, y, z in (begin, via, end))
        raise DataError(f"no arc passes {places} m: the places are on a straight line")
    # the centre is as far from all three
    planes = np.array([first, second, normal])
    middles = np.array([first @ (begin + via), second @ (via + end), 2.0 * (normal @ begin)]) / 2.0
    centre = np.linalg.solve(planes, middles)
    axis = normal / np.linalg.norm(normal)
    across = np.cross(axis, begin - centre)
    angle = float(np.arctan2((end - centre) @ across, (end - centre) @ (begin - centre)))
    return _Arc(begin - centre, end - centre, axis * (angle % (2.0 * np.pi)), size)
