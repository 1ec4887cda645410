"""Rounded corners between straight legs.

In a corner the velocity turns from that of one leg to that of the next by the smooth step 3 u^2 - 2 u^3, in a fixed
time: acceleration is continuous with the straight parts, where it is zero at both ends of the corner, and jerk is
bounded. Corners are run through at the constant speed that limits allow, so that their shape does not depend on time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_mcs.planning.motion_limits import MotionLimits
from im_mcs.planning.polynomial import PiecewisePolynomial
from im_mcs.planning.profile import transition_distance

# largest first and second derivative of the smooth step
_SLOPE, _BEND = 1.5, 6.0
# shares of acceleration and jerk that a corner uses, so that a motion can be slowed down in it
_FORCE, _JERK = 0.8, 0.6
_STEPS = 40

Limits = tuple[float, float, float]


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
        """The fastest corner at ``point`` that stays within ``blend`` of it; at most half of each leg is rounded."""
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
        """Share of the leg before that is covered in a second, at the begin."""
        return 2.0 * self.entry / self.time

    @property
    def exit_speed(self) -> float:
        """Share of the leg after that is covered in a second, at the end."""
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
    """Slow corners down, in place and one at a time, until the straight parts between them suffice to change speed in.

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
    """Largest share of ``fast`` that is reached from ``slow`` within ``length``; 1 if it is slower anyway."""
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
