"""Trajectory beyond limits: along the same path, in the original time where possible.

Path and time are told apart (:mod:`.asked_path`). Between two places of rest the time is changed if a limit is passed
there (:mod:`.stretch`); a stretch within limits stays as it was asked for.
"""

from collections.abc import Generator, Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import LimitError
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.checks.envelope import first_excess
from im_mcs.planning.retiming.asked_path import AskedPath
from im_mcs.planning.retiming.rounding import rounded
from im_mcs.planning.retiming.stops import SAME_S, rests, standing
from im_mcs.planning.retiming.stretch import Retimed, check_count, retime_stretch
from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, powers

Array = NDArray[np.float64]

# how far a rounded change of curvature may be off the asked path
_DEPTH = {"rad": 2e-4, "m": 2e-5}
_NO_FORCE = 1e-6
_COPIED = 4000


class RetimedTrajectory(PiecewisePolynomial):
    """An asked trajectory in a longer time.

    Attributes:
        because: The first place where the asked one is beyond a limit.
        asked: The asked one.
        smoothed: What noise in its positions has cost, as a clause; empty: it has none.

    Args:
        lengths, coefficients, points: As for every trajectory.
        times: Asked times at the ends of its pieces, shape (m + 1,) [s].
        asked: As above.
        because: As above.
    """

    def __init__(
        self,
        lengths: Array,
        coefficients: Array,
        points: Sequence[int],
        times: Array,
        asked: PiecewisePolynomial,
        because: LimitError,
    ) -> None:
        super().__init__(lengths, coefficients, points)
        self._times, self.asked, self.because = times, asked, because
        self.smoothed = ""

    def asked_time(self, t: float) -> float:
        """Return the requested trajectory's time at the place of the re-timed one at time ``t`` [s]."""
        return float(np.interp(t, np.append(self.edges, self.duration), self._times))

    @property
    def report(self) -> str:
        """Changes, with the reasons."""
        facts = self.because.facts
        retimed = (
            f"re-timed along its path: {self.duration:.3f} s instead of {self.asked.duration:.3f} s, because of "
            f"{facts['quantity']} of {facts['joint']} at {facts['time']:.3f} s"
        )
        if not self.smoothed:
            return retimed
        return f"{self.smoothed}, then {retimed}" if self.duration > self.asked.duration else self.smoothed


def retime(
    context: PlanContext, asked: PiecewisePolynomial, because: LimitError
) -> Generator[None, None, RetimedTrajectory]:
    """Re-time a trajectory between two rests, a slice at a time.

    Args:
        context: Limits and joints.
        asked: The trajectory, continuous to velocity.
        because: The first place where it is beyond a limit.

    Raises:
        DataError: It is too long to be re-timed.
    """
    limits = context.limits.motion.of(context.index)
    depth = np.array([_DEPTH[context.limits.units[i]] for i in context.index])
    smooth = yield from rounded(asked, limits.acceleration, limits.velocity, depth)
    path = AskedPath(smooth, 0.0, smooth.duration, limits.velocity)
    yield from path.measure()
    times = yield from rests(smooth, path, limits.velocity)
    parts, count = list[Retimed](), 0
    still = yield from standing(asked, limits.velocity)
    for begin, end in zip(times[:-1].tolist(), times[1:].tolist(), strict=True):
        kept = yield from _kept(context, asked, begin, end, still)  # what keeps the limits stays as asked
        more = [kept] if kept else (yield from retime_stretch(smooth, begin, end, limits))
        parts += more
        count += sum(len(part.lengths) for part in more)
        check_count(count, asked.duration)
    ends = np.concatenate([[0.0], *(part.asked[1:] for part in parts)])
    middles = (ends[1:] + ends[:-1]) / 2.0
    points = np.array(asked.points)[np.clip(np.searchsorted(asked.edges, middles, side="right") - 1, 0, None)].tolist()
    yield
    whole, filled = np.empty((count, *smooth.coefficients.shape[1:])), 0
    for part in parts:
        for k in range(0, len(part.lengths), _COPIED):  # in slices: the servo ticks between them
            some = part.coefficients[k : k + _COPIED]
            whole[filled : filled + len(some)] = some
            filled += len(some)
            yield
    return RetimedTrajectory(
        np.concatenate([part.lengths for part in parts]),
        whole,
        points,
        ends,
        asked,
        because,
    )


def _kept(
    context: PlanContext, asked: PiecewisePolynomial, begin: float, end: float, still: NDArray[np.bool_]
) -> Generator[None, None, Retimed | None]:
    """Return a stretch unchanged, if motionless, or within all limits from rest to rest."""
    edges = np.append(asked.edges, asked.duration)
    first, last = (min(int(np.searchsorted(edges, t - SAME_S)), len(edges) - 1) for t in (begin, end))
    if abs(edges[first] - begin) > SAME_S or abs(edges[last] - end) > SAME_S:
        return None
    lengths, coefficients = asked.lengths[first:last], asked.coefficients[first:last]
    if not still[first:last].all():
        forces = 2.0 * coefficients[0, 2], (powers(lengths[-1:]) @ coefficients[-1])[0, 2]
        if max(np.abs(force).max() for force in forces) > _NO_FORCE:
            return None
        before = np.zeros(asked.coefficients.shape[2])
        if (yield from first_excess(context, asked, range(first, last), before)) is not None:
            return None
    return Retimed(lengths, coefficients, edges[first : last + 1])
