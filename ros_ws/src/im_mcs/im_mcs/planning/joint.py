"""Joint-interpolated motion through points (paper, section 4): straight legs, time-optimal and jerk-limited."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.blend import Corner, fit_speeds
from im_mcs.planning.motion_limits import MotionLimits, Synchrony
from im_mcs.planning.polynomial import PiecewisePolynomial
from im_mcs.planning.profile import along, to_point
from im_mcs.planning.setpoint import Setpoint

_SAME = 1e-9


class JointPath(PiecewisePolynomial):
    """Consecutive joint-interpolated legs.

    Without blending every point is a rest and every leg is the time-optimal motion between two rests. With blending the
    corner at each point is rounded, at constant speed, within ``blend`` of the point (:mod:`im_mcs.planning.blend`);
    legs then are straight whatever the synchrony.

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
        """The whole, once it is done."""
        if not self._parts:
            return PiecewisePolynomial.standing(self._corners[-1])
        return self._parts[0].followed_by(self._parts[1:])

    def step(self) -> None:
        """Do a small part of the work: a corner, its speed, or a leg.

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
        """The straight part of a leg, and the corner at its end."""
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
