"""Joint-interpolated motion through points (paper, section 4): straight legs, time-optimal and jerk-limited.

Corners between legs may be rounded. In a corner the velocity turns from that of one leg to that of the next by the
smooth step 3 u^2 - 2 u^3, in a fixed time: acceleration is continuous with the straight parts, where it is zero at both
ends of the corner, and jerk is bounded. Corners are run through at the constant speed that limits allow, so that their
shape does not depend on time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from im_mcs.limits.motion_limits import MotionLimits, Synchrony
from im_mcs.planning.checks.context import PlanContext, Start
from im_mcs.planning.checks.envelope import check_range
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial
from im_mcs.planning.trajectories.profile import along, to_point, transition_distance
from im_mcs.planning.trajectories.trajectory import Setpoint, Trajectory
from im_mcs.protocol.requests import JointMove

_SAME = 1e-9
_STEPS_A_SLICE = 5
# share of the jerk that a motion uses whose joints do not keep phase, so that it can be slowed down on its path
_JERK_UNPHASED = 0.6
# largest first and second derivative of the smooth step
_SLOPE, _BEND = 1.5, 6.0
# shares of acceleration and jerk that a corner uses, so that a motion can be slowed down in it
_FORCE, _JERK = 0.8, 0.6
_STEPS = 40

Limits = tuple[float, float, float]


class JointPath(PiecewisePolynomial):
    """Consecutive joint-interpolated legs.

    Without blending every point is a rest and every leg is the time-optimal motion between two rests. With blending the
    corner at each point is rounded, at constant speed, within ``blend`` of the point; legs then are straight whatever
    the synchrony.

    Args:
        start: Where the motion begins, at rest, shape (n,) [rad or m].
        points: Points to pass, shape (m, n), m > 0.
        limits: Limits of velocity, acceleration and jerk.
        synchrony: How the joints keep step.
        blend: Largest distance of a joint to the point at which a corner may begin [rad or m]; 0: rest in each point.

    Raises:
        DataError: Ruckig finds no trajectory.
    """

    def __init__(
        self,
        start: NDArray[np.float64],
        points: NDArray[np.float64],
        limits: MotionLimits,
        synchrony: Synchrony = Synchrony.PHASE,
        blend: float = 0.0,
    ) -> None:
        planner = JointPathPlanner(start, points, limits, synchrony, blend)
        while not planner.done:
            planner.step()
        whole = planner.trajectory
        super().__init__(whole.lengths.tolist(), whole.coefficients, whole.points)


class JointPathPlanner:
    """Plans a :class:`JointPath` step by step; arguments as there.

    Attributes:
        done: Whether all is planned.
    """

    def __init__(
        self,
        start: NDArray[np.float64],
        points: NDArray[np.float64],
        limits: MotionLimits,
        synchrony: Synchrony,
        blend: float,
    ) -> None:
        corners = np.vstack([np.asarray(start, dtype=np.float64), points])
        ways = np.diff(corners, axis=0)
        # a point that is where the motion already is adds nothing
        self._moves = [i for i, way in enumerate(ways) if np.abs(way).max() > _SAME]
        self._corners, self._ways = corners, ways
        self._limits, self._synchrony, self._blend = limits, synchrony, blend
        self._parts: list[PiecewisePolynomial] = []
        self._bends: list[Corner] = []
        self._work = self._plan()
        self.done = False

    @property
    def trajectory(self) -> PiecewisePolynomial:
        """Whole trajectory, once done."""
        if not self._parts:
            return PiecewisePolynomial.standing(self._corners[-1])
        return self._parts[0].followed_by(self._parts[1:])

    def step(self) -> None:
        """Do a small part of the work: a corner, the speed, or a leg.

        Raises:
            DataError: Ruckig finds no trajectory.
        """
        if next(self._work, self) is self:
            self.done = True

    def _plan(self) -> Iterator[None]:
        limits = []
        for leg in self._moves:
            limits.append(self._limits.along(self._ways[leg]))
            yield
        if self._blend > 0.0:
            for leg, after in pairwise(self._moves):
                point, ways = self._corners[leg + 1], (self._ways[leg], self._ways[after])
                self._bends.append(Corner.between(point, *ways, self._blend, self._limits))
                yield
            yield from fit_speeds(self._bends, limits)
        for k, leg in enumerate(self._moves):
            if self._blend > 0.0:
                self._straight(k, leg, limits[k])
            elif self._synchrony is Synchrony.TIME:
                start = Setpoint.at_rest(self._corners[leg])
                self._add(to_point(start, self._corners[leg + 1], self._limits, Synchrony.TIME), leg)
            else:
                self._line(leg, 0.0, *along(1.0, (0.0, 0.0), limits[k]))
            yield

    def _straight(self, k: int, leg: int, limits: tuple[float, float, float]) -> None:
        """Plan the straight part of a leg, and the corner at the end."""
        before = self._bends[k - 1] if k > 0 else None
        after = self._bends[k] if k < len(self._bends) else None
        first, v0 = (before.exit, before.exit_speed) if before else (0.0, 0.0)
        last, v1 = (1.0 - after.entry, after.entry_speed) if after else (1.0, 0.0)
        if last - first > _SAME:
            self._line(leg, first, *along(last - first, (v0, v1), limits))
        if after is not None:
            self._add(after.polynomial(), leg)

    def _line(self, leg: int, first: float, lengths: Sequence[float], covered: NDArray[np.float64]) -> None:
        way = self._ways[leg]
        coefficients = covered[:, :, None] * way
        coefficients[:, 0] += self._corners[leg] + first * way
        self._add(PiecewisePolynomial(lengths, coefficients), leg)

    def _add(self, part: PiecewisePolynomial, leg: int) -> None:
        part.points = [leg] * len(part.points)
        self._parts.append(part)


class JointPreparation:
    """Prepares a joint-interpolated motion.

    From rest it is a :class:`JointPath`. From a motion under way the first point is
    reached, at rest, by the time-optimal motion from the state at which it takes over, then the rest follows.
    """

    def __init__(self, context: PlanContext, move: JointMove, start: Start) -> None:
        self._context, self._move, self._start = context, move, start
        self._limits = context.limits.motion.of(context.index)
        self._first = move.points[0]
        self._begin(start())

    def _begin(self, state: Setpoint) -> None:
        """Begin to plan from a state; a state of rest must not be left meanwhile."""
        self._from, self._moving = state.q, _moves(state)
        points = self._move.points
        begin, points = (points[0], points[1:]) if self._moving else (state.q, points)
        synchrony = self._context.config.planning.synchrony
        self._legs = JointPathPlanner(begin, points, self._limits, synchrony, self._move.blend)

    def step(self) -> Trajectory | None:
        """Do a few steps; the last slice joins the result to the motion under way."""
        state = self._start()
        if not self._moving and (_moves(state) or not np.array_equal(state.q, self._from)):
            self._begin(state)  # what stood still has been resumed, or another motion has begun
        if not self._legs.done:
            for _ in range(_STEPS_A_SLICE):
                if not self._legs.done:
                    self._legs.step()
            return None
        if not self._moving:
            return self._legs.trajectory
        synchrony = self._context.config.planning.synchrony
        limits = replace(self._limits, jerk=self._limits.jerk * _JERK_UNPHASED)
        first = to_point(state, self._first, limits, synchrony)
        # a motion that turns round may swing past the range of a joint
        check_range(self._context, first)
        rest = self._legs.trajectory
        rest.points = [point + 1 for point in rest.points]
        return first.followed_by([rest]) if rest.duration > 0.0 else first


def _moves(state: Setpoint) -> bool:
    return bool(state.v.any() or state.a.any())


@dataclass(frozen=True)
class Corner:
    """A rounded corner.

    Attributes:
        begin: Where it leaves the leg before, shape (n,).
        before: Way of the leg before, shape (n,).
        after: Way of the leg after, shape (n,).
        entry: Share of the leg before that the corner replaces.
        exit: Share of the leg after that the corner replaces.
        time: How long it takes [s].
    """

    begin: NDArray[np.float64]
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    entry: float
    exit: float
    time: float

    @classmethod
    def between(
        cls,
        point: NDArray[np.float64],
        before: NDArray[np.float64],
        after: NDArray[np.float64],
        blend: float,
        limits: MotionLimits,
    ) -> "Corner":
        """Return the fastest corner at ``point`` within the radius ``blend``; at most half of each leg is rounded."""
        entry = min(0.5, blend / float(np.abs(before).max()))
        leave = min(0.5, blend / float(np.abs(after).max()))
        v0, v1 = 2.0 * entry * before, 2.0 * leave * after
        turn = np.abs(v1 - v0)
        fastest = max(
            float((np.maximum(np.abs(v0), np.abs(v1)) / limits.velocity).max()),
            float(np.sqrt((_SLOPE / _FORCE) * turn / limits.acceleration).max()),
            float(np.cbrt((_BEND / _JERK) * turn / limits.jerk).max()),
        )
        return cls(point - entry * before, before, after, entry, leave, fastest)

    @property
    def entry_speed(self) -> float:
        """Share of the leg before, covered in a second, at the begin."""
        return 2.0 * self.entry / self.time

    @property
    def exit_speed(self) -> float:
        """Share of the leg after, covered in a second, at the end."""
        return 2.0 * self.exit / self.time

    def slowed(self, factor: float) -> "Corner":
        """The same shape at a share of the speed."""
        return replace(self, time=self.time / factor)

    def polynomial(self) -> PiecewisePolynomial:
        """The corner as a polynomial in time."""
        t = self.time
        v0, v1 = 2.0 * self.entry * self.before / t, 2.0 * self.exit * self.after / t
        turn = v1 - v0
        zero = np.zeros_like(v0)
        return PiecewisePolynomial([t], np.array([[self.begin, v0, zero, turn / t**2, -0.5 * turn / t**3, zero]]))


def fit_speeds(corners: list[Corner], limits: Sequence[Limits]) -> Iterator[None]:
    """Slow corners down, in place and one at a time, until the straight parts suffice for the changes of speed.

    Args:
        corners: m of them, between m + 1 legs.
        limits: Speed, acceleration and jerk along each leg.
    """
    # backwards: decelerations; then forwards: accelerations. A corner slowed in the second pass lies behind one that
    # is slower still, so that the first pass stays right.
    for k in range(len(corners) - 1, -1, -1):
        corner = corners[k]
        length, end = 1.0 - corner.exit, 0.0
        if k + 1 < len(corners):
            length, end = length - corners[k + 1].entry, corners[k + 1].entry_speed
        corners[k] = corner.slowed(_share(corner.exit_speed, end, length, limits[k + 1]))
        yield
    for k, corner in enumerate(corners):
        length, begin = 1.0 - corner.entry, 0.0
        if k > 0:
            length, begin = length - corners[k - 1].exit, corners[k - 1].exit_speed
        corners[k] = corner.slowed(_share(corner.entry_speed, begin, length, limits[k]))
        yield


def _share(fast: float, slow: float, length: float, limits: Limits) -> float:
    """Return the largest share of ``fast`` reached from ``slow`` within ``length``; 1 if slower anyway."""
    _, acceleration, jerk = limits
    # a hair less than what fits, as the profile is to be found by another
    room = length * (1.0 - 1e-9)
    if fast <= slow or transition_distance(slow, fast, acceleration, jerk) <= room:
        return 1.0
    low, high = slow, fast
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        if transition_distance(slow, middle, acceleration, jerk) <= room:
            low = middle
        else:
            high = middle
    return low / fast
