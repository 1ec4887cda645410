"""Distances at every servo tick: slow down before bodies come close, stop before bodies come too close."""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import cycle
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError
from im_mcs.collision.bodies import Bodies, ancestors
from im_mcs.collision.braking_distance import STRAIGHT, Ahead, BrakingDistance
from im_mcs.collision.surroundings import NOTHING, CollisionScene
from im_mcs.limits.configuration import Collision
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.limits.vectors import all_finite
from im_mcs.model import CellModel


def lever_bounds(model: CellModel, bodies: Bodies) -> NDArray[np.float64]:
    """Largest change of each pair's distance by unit motion of each joint, shape (pairs, joints) [m/rad or 1].

    A point that a revolute joint carries moves by at most the angle times its distance from the axis; that distance is
    at most what the offsets of the joints in between add up to, those that slide with their longest way. A joint that
    carries both bodies of a pair, or none of them, does not change their distance.
    """
    carried = np.array([_levers(model, joint, ends.tobytes()) for joint, ends in bodies.ends]).reshape(-1, model.n)
    first, second = carried[bodies.pairs[:, 0]], carried[bodies.pairs[:, 1]]
    return np.where((first > 0.0) & (second > 0.0), 0.0, first + second)


@lru_cache(maxsize=256)
def _levers(model: CellModel, joint: int, ends: bytes) -> NDArray[np.float64]:
    """Bounds of the levers of a body, shape (n,): those of the cell's own links are computed once."""
    levers, chain = np.zeros(model.n), ancestors(model, joint)[:-1]
    for rank, carrier in enumerate(chain):
        levers[carrier - 1] = _lever(model, carrier, chain[:rank][::-1], np.frombuffer(ends).reshape(-1, 3))
    return levers


def _lever(model: CellModel, carrier: int, between: list[int], ends: NDArray[np.float64]) -> float:
    """Bound of the distance from the axis of ``carrier`` to the ends of a body, over the joints ``between``."""
    joints = model.cell.joints
    if joints[carrier - 1].kind == "prismatic":
        return 1.0
    axis = np.array(joints[carrier - 1].axis)
    if not between:
        return float(max(_off_axis(axis, end) for end in ends))
    offsets = [model.pin.jointPlacements[joint].translation for joint in between]
    along = [_off_axis(axis, offsets[0]), *(float(np.linalg.norm(offset)) for offset in offsets[1:])]
    sliding = [joints[joint - 1].limits for joint in between if joints[joint - 1].kind == "prismatic"]
    ways = [max(abs(limits.lower), abs(limits.upper)) for limits in sliding]
    return sum(along) + sum(ways) + float(np.linalg.norm(ends, axis=1).max())


def _off_axis(axis: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.cross(axis, point)))


# Approaches below this are rounding of the distances [m].
_ROUNDING_M = 1e-6
# The slow-down is in full force where braking brings bodies closer by this share of the zone; below, it fades.
_FULL_APPROACH = 0.1
# A speed ceiling falls at once and recovers at this rate, lest speed and ceiling chase each other [1/s].
_RECOVERY = 1.0
# Pairs that are measured in turn at every tick, and how many may be measured to find the closest.
_IN_TURN = 3
_LOOKS = 8


class Proximity(NamedTuple):
    """Finding of the monitor in one tick.

    Attributes:
        distance: Of the closest pair where the joints come to rest if they brake now, negative if they overlap [m];
            beyond ``slow_down_m`` it may be a bound below it.
        first, second: Links or boxes of that pair; if ``stop``, of the pair that is the reason.
        speed_ceiling: Share of full speed that moving groups may have, 0 to 1.
        stop: Whether a protective stop is due.
    """

    distance: float
    first: str
    second: str
    speed_ceiling: float
    stop: bool


class CollisionMonitor:
    """Watch over all pairs of bodies at the places of rest of joints braking from now on.

    Pairs that braking brings closer slow the motion down from ``slow_down_m`` on, and stop it at ``stop_m``. Motion
    that takes bodies apart, or leaves their distance, goes on at any distance: after a stop the way back is free.

    A distance is measured anew when the joints may have brought the pair into the zone since it was measured last
    (conservative advancement; B. Mirtich, 1996): distances change by at most the joints' travel times their levers.
    A few more are measured at every tick, in turn and to find the closest pair.

    Args:
        model: Kinematics and shapes.
        limits: Of all joints; the decelerations that are counted on.
        settings: Distances.
        groups: Joints that brake together, one array a group.
        period_s: Servo period [s].
    """

    def __init__(
        self,
        model: CellModel,
        limits: MotionLimits,
        settings: Collision,
        groups: Sequence[NDArray[np.intp]],
        period_s: float,
    ) -> None:
        self._model, self._settings = model, settings
        self._braking = BrakingDistance(limits, groups, settings.reaction_ticks * period_s)
        self._place = np.zeros(model.n)
        self._rise = _RECOVERY * period_s
        self._ceiling = 1.0
        self.surround(NOTHING)

    def surround(self, around: CollisionScene) -> None:
        """Watch other free bodies and pairs from the next tick on."""
        self._bodies = Bodies(self._model, around)
        self._levers = lever_bounds(self._model, self._bodies)
        self._names = [self._bodies.pair_names(pair) for pair in range(len(self._bodies.pairs))]
        self._lower = np.full(len(self._bodies.pairs), -np.inf)
        pairs = range(len(self._lower))
        self._turns = cycle([pairs[k : k + _IN_TURN] for k in pairs[::_IN_TURN]])

    def update(
        self,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        a: NDArray[np.float64],
        curves: Mapping[int, Ahead] = STRAIGHT,
    ) -> Proximity:
        """Look at one tick.

        Args:
            q: Measured positions of all joints, shape (n,) [rad or m].
            v: Their velocities, shape (n,) [rad/s or m/s]; of the setpoint where a group moves.
            a: Their accelerations, shape (n,) [rad/s2 or m/s2]; likewise.
            curves: Groups on curved paths, by their first joint: where these lead.

        Raises:
            DataError: A value is not a finite number.
        """
        if not (all_finite(q) and all_finite(v) and all_finite(a)):
            raise DataError("the collision monitor was given a motion that is not finite")
        if not self._names:
            return Proximity(math.inf, "", "", 1.0, False)
        place = q + self._braking.displacement(v, a, curves)
        self._lower -= self._levers.dot(np.abs(place - self._place))
        self._place = place
        self._bodies.place(place)
        closest = self._refresh()
        ceiling, culprit = 1.0, None
        if self._lower[closest] < self._settings.slow_down_m:
            ceiling, culprit = self._judge(self._near(), q)
            closest = int(self._lower.argmin()) if culprit is None else culprit
        self._ceiling = min(ceiling, self._ceiling + self._rise)
        distance = float(self._lower[closest])
        return Proximity(distance, *self._names[closest], self._ceiling, culprit is not None)

    def _refresh(self) -> int:
        """Measure some pairs in turn, and all possibly closest ones within the zone; return the closest."""
        lower, distance = self._lower, self._bodies.distance
        for pair in next(self._turns):
            lower[pair] = distance(pair)
        closest = int(lower.argmin())
        for _ in range(_LOOKS):
            bound = lower[closest]
            if bound >= self._settings.slow_down_m:
                break
            lower[closest] = found = distance(closest)
            if found <= bound:
                break
            closest = int(lower.argmin())
        return closest

    def _near(self) -> NDArray[np.intp]:
        """Return measured pairs with the rest within the zone."""
        zone = self._settings.slow_down_m
        for pair in np.flatnonzero(self._lower < zone).tolist():
            self._lower[pair] = self._bodies.distance(pair)
        return np.flatnonzero(self._lower < zone)

    def _judge(self, near: NDArray[np.intp], q: NDArray[np.float64]) -> tuple[float, int | None]:
        """Return the speed ceiling, and the worst pair too close after braking, if there is one.

        Args:
            near: Pairs that end within the zone.
            q: Where the joints are.
        """
        zone, allowed = self._settings.slow_down_m, self._settings.stop_m
        self._bodies.place(q)
        ceiling, culprit = 1.0, None
        for pair in near:
            end = self._lower[pair]
            approach = self._bodies.distance(int(pair)) - end
            if approach <= _ROUNDING_M:
                continue
            if end < allowed and (culprit is None or end < self._lower[culprit]):
                culprit = int(pair)
            share = max(end - allowed, 0.0) / (zone - allowed)
            share = max(share, 1.0 - approach / (_FULL_APPROACH * zone))
            ceiling = min(ceiling, self._settings.slowest + (1.0 - self._settings.slowest) * share)
        return ceiling, culprit
