"""Selection and order of poses: far apart from each other, short ways between neighbours, free of collisions."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from im_cell.motion_time import motion_times
from im_core.errors import DataError, ImError
from im_mcs.collision import CollisionChecker
from im_mcs.inverse import InverseKinematics
from im_mcs.inverse.arm import ARM_JOINTS
from im_mcs.inverse.solver import LIMIT_MARGIN
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.planning.motions.joint import JointPath
from im_mcs.poses.candidates import Candidate, Carried, candidates, held
from im_mcs.poses.common import CommonView
from im_mcs.poses.short_ways import ShortWays
from im_mcs.poses.view import View


@dataclass(frozen=True)
class Spread:
    """Measures of a set of poses.

    Attributes:
        nearest_m: Least distance between two lights [m].
        hole_m: Largest distance of a usable place from the nearest light: the dispersion of the set [m].
        turning: Least variance of the direction of an axis of the wrist, over all axes fixed to the wrist: 0 if the
            wrist turns about one axis or not at all, so that an offset along it cannot be seen; 1 for orientations
            spread over all rotations.
    """

    nearest_m: float
    hole_m: float
    turning: float


def spread_of(lights: NDArray[np.float64], wrists: NDArray[np.float64], usable: NDArray[np.float64]) -> Spread:
    """Measure a set of poses.

    Args:
        lights: Positions of the light, shape (n, 3) [m].
        wrists: Rotations of the wrist, shape (n, 3, 3).
        usable: Places that could have been chosen, shape (m, 3) [m].
    """
    tree = cKDTree(lights)
    between = tree.query(lights, k=2)[0][:, 1] if len(lights) > 1 else np.array([np.inf])
    largest_mean = np.linalg.svd(wrists.mean(axis=0), compute_uv=False)[0]
    return Spread(float(between.min()), float(tree.query(usable)[0].max()), float(1.0 - largest_mean**2))


def farthest_first(points: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Return ranks of points, shape (count,): the innermost, then always the farthest (Gonzalez, 1985).

    They leave holes at most twice as large as the best choice would.

    Args:
        points: Shape (n, 3), n >= count [m].
        count: How many.
    """
    first = int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))
    order, distance = [first], np.linalg.norm(points - points[first], axis=1)
    while len(order) < count:
        order.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[order[-1]], axis=1))
    return np.array(order, dtype=np.intp)


_LIGHT_RADIUS_M = 0.012
_FIRST_STEP_M = 0.02
_CANDIDATES_PER_POSE = 12
_MAX_TRIES_PER_POSE = 150
_MAX_DRAWS_PER_POSE = 4000
# Configurations that are drawn about one: how often, the share of the carriers' ranges that they are spread over at
# first, and how many positions of the arm's joints are taken for each.
_DRAWS, _SPREAD, _NEAREST = 60, 0.25, 2


@dataclass(frozen=True, eq=False)
class PlacedPose:
    """Candidate with joint positions.

    Attributes:
        candidate: Pose.
        q: Positions of the group, shape (n,) [rad or m].
    """

    candidate: Candidate
    q: NDArray[np.float64]


@dataclass(frozen=True)
class Selection:
    """Poses in the order of the visits, and the fill of the cameras' view."""

    poses: tuple[PlacedPose, ...]
    spread: Spread


class PoseSelector:
    """Selector of poses of one group in view of several cameras.

    Args:
        model: Kinematics, shapes and the light.
        limits: Of the joints.
        checker: Of collisions.
        index: Joints of the group, shape (n,).
        frame: Its wrist.
        views: Cameras that shall see the light.
        shown: The light, or a board.

    Raises:
        DataError: The cameras see no place in common that the light can reach.
    """

    def __init__(
        self,
        model: CellModel,
        limits: JointLimits,
        checker: CollisionChecker,
        index: NDArray[np.intp],
        frame: str,
        views: Sequence[View],
        shown: Carried,
    ) -> None:
        self._model, self._shown = model, shown
        self._limits = limits
        self._checker = checker
        self._index = index
        self._views = views
        self._solver = InverseKinematics(model, limits, index, frame)
        self._of_arm = np.isin(index, model.joints_below(frame)[-ARM_JOINTS:])
        self._arm = InverseKinematics(model, limits, index[self._of_arm], frame)
        self._home = model.cell.home
        self._common = CommonView(model, limits, index, frame, views, shown.offset)

    def select(self, count: int, max_tilt_rad: float, seed: int, told: Callable[[str], None]) -> Selection:
        """Choose and order poses.

        Args:
            count: How many.
            max_tilt_rad: How far the light may be turned away from where it faces all cameras best [rad].
            seed: Of the candidates.
            told: Takes a sentence of progress.

        Raises:
            DataError: There are not so many; the message says what the others lack.
        """
        pool = self._pool(count, max_tilt_rad, seed, told)
        lights = np.array([placed.candidate.light for placed in pool])
        wanted = [int(k) for k in farthest_first(lights, count)]
        tried = set(wanted)
        while True:
            ordered, stranded = self._order(pool, wanted)
            others = [_nearest_other(lights, k, tried) for k in stranded]
            if None in others or not others:
                break
            wanted = [k for k in wanted if k not in stranded] + [k for k in others if k is not None]
        if len(ordered) < count:
            raise DataError(f"only {len(ordered)} of {count} poses can be reached one after the other")
        ordered = self._shortened(ordered, seed, told)
        wrists = np.array([placed.candidate.wrist.rotation for placed in ordered])
        chosen = np.array([placed.candidate.light for placed in ordered])
        return Selection(tuple(ordered), spread_of(chosen, wrists, lights))

    def _pool(self, count: int, max_tilt_rad: float, seed: int, told: Callable[[str], None]) -> list[PlacedPose]:
        """Reachable, free and visible candidates."""
        pool, lacks = list[PlacedPose](), Counter[str]()
        shown, views, draws = self._shown, self._views, _MAX_DRAWS_PER_POSE * count
        stream = (
            held(shown, self._common.wrists, views, max_tilt_rad)
            if len(self._index) < ARM_JOINTS
            else candidates(shown, self._common, views, max_tilt_rad, seed, draws)
        )
        for tries, candidate in enumerate(stream, start=1):
            found = self._try(candidate)
            if isinstance(found, PlacedPose):
                pool.append(found)
                if len(pool) % count == 0:
                    told(f"{len(pool)} of {_CANDIDATES_PER_POSE * count} candidates")
            else:
                lacks[found] += 1
            if len(pool) == _CANDIDATES_PER_POSE * count or tries == _MAX_TRIES_PER_POSE * count:
                break
        if len(pool) < count:
            named = ", ".join(f"{number} {lack}" for lack, number in lacks.most_common()) or "none is in every view"
            raise DataError(f"only {len(pool)} poses of {count} can be used; of the others tried: {named}")
        return pool

    def _try(self, candidate: Candidate) -> PlacedPose | str:
        """Return a candidate with joint positions, or the reason against the candidate."""
        lack = "are out of reach"
        starts = (self._common.start(candidate.light), self._home[self._index])
        for attempt in self._solver.attempts(candidate.wrist, self._home, starts):
            if not attempt.reached:
                continue
            try:
                self._checker.require_free(self._whole(attempt.q))
            except ImError:
                lack = "are in collision"
                continue
            blocked = self._blocked(candidate, attempt.q)
            if blocked is None:
                return PlacedPose(candidate, attempt.q)
            lack = f"are hidden from {blocked}"
        return lack

    def _blocked(self, candidate: Candidate, q: NDArray[np.float64]) -> str | None:
        """Return a camera with an obstacle before the light, if there is one."""
        whole, rim = self._whole(q), [candidate.wrist.act(place) for place in self._shown.rim]
        for view, place in product(self._views, (candidate.light, *rim)):
            towards = view.position - place
            start = place + towards / np.linalg.norm(towards) * _FIRST_STEP_M
            if self._checker.blocking(whole, start, view.position, _LIGHT_RADIUS_M) is not None:
                return view.name
        return None

    def _order(self, pool: Sequence[PlacedPose], wanted: Sequence[int]) -> tuple[list[PlacedPose], list[int]]:
        """Order poses from home, always to the next one soon reached on a free, direct way; return also the rest."""
        here, left, ordered = self._home[self._index], list(wanted), list[PlacedPose]()
        while left:
            for k in sorted(left, key=lambda k: (self._duration(here, pool[k].q), k)):
                placed = self._place(pool[k].candidate, here)
                if placed is not None and self._free(here, placed.q):
                    ordered.append(placed)
                    here = placed.q
                    left.remove(k)
                    break
            else:
                return ordered, left
        return ordered, []

    def _shortened(self, poses: Sequence[PlacedPose], seed: int, told: Callable[[str], None]) -> list[PlacedPose]:
        """Poses in an order and in configurations that take less time."""
        cell, rng = self._model.cell, np.random.default_rng(seed)
        names = [self._model.names[rank] for rank in self._index]
        ways = ShortWays(
            lambda a, b: motion_times(cell, names, a[:, None] - b[None]),
            lambda rank, q, spread: self._configurations(poses[rank].candidate, q, spread, rng),
            self._free,
        )
        visits = ways.shorten(self._home[self._index], [placed.q for placed in poses], told)
        return [PlacedPose(poses[rank].candidate, q) for rank, q in visits]

    def _configurations(
        self, candidate: Candidate, q: NDArray[np.float64], spread: float, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Draw usable configurations about ``q`` for the same pose, shape (m, n), at a spread of 0 to 1."""
        found, carriers, arm = list[NDArray[np.float64]](), ~self._of_arm, self._of_arm
        lower, upper = self._limits.lower[self._index][carriers], self._limits.upper[self._index][carriers]
        for drawn in rng.normal(size=(_DRAWS if carriers.any() else 1, len(lower))):
            other = q.copy()
            other[carriers] += _SPREAD * spread * (upper - lower) * drawn
            other[carriers] = np.clip(other[carriers], lower + LIMIT_MARGIN, upper - LIMIT_MARGIN)
            for attempt in self._arm.solutions(candidate.wrist, self._whole(other), q[arm])[:_NEAREST]:
                whole = other.copy()
                whole[arm] = attempt.q
                if self._usable(candidate, whole):
                    found.append(whole)
        return np.reshape(found, (-1, len(q)))

    def _usable(self, candidate: Candidate, q: NDArray[np.float64]) -> bool:
        try:
            self._checker.require_free(self._whole(q))
        except ImError:
            return False
        return self._blocked(candidate, q) is None

    def _place(self, candidate: Candidate, here: NDArray[np.float64]) -> PlacedPose | None:
        """Return the configuration of path planning's choice from the group's present one."""
        try:
            q = self._solver.solve(candidate.wrist, self._home, here, self._checker)
        except ImError:
            return None
        return PlacedPose(candidate, q) if self._blocked(candidate, q) is None else None

    def _duration(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
        return JointPath(a, b[None, :], self._limits.motion.of(self._index)).duration

    def _free(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
        try:
            self._checker.check_path(self._home, self._index, np.array([a, b]))
        except ImError:
            return False
        return True

    def _whole(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = self._home.copy()
        whole[self._index] = q
        return whole


def _nearest_other(lights: NDArray[np.float64], k: int, tried: set[int]) -> int | None:
    """Return the untried light nearest to light ``k`` and mark as tried; None if all were tried."""
    for other in np.argsort(np.linalg.norm(lights - lights[k], axis=1), kind="stable"):
        if int(other) not in tried:
            tried.add(int(other))
            return int(other)
    return None
