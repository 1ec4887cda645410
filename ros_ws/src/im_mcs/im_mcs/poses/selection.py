"""Selection and order of poses: far apart from each other, short ways between neighbours, free of collisions."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, ImError
from im_core.robot import Camera
from im_mcs.collision import CollisionChecker
from im_mcs.inverse import InverseKinematics
from im_mcs.limits import JointLimits
from im_mcs.model import Model
from im_mcs.planning.joint_path import JointPath
from im_mcs.poses.candidates import Candidate, Volume, candidates

_LIGHT_RADIUS_M = 0.012
_FIRST_STEP_M = 0.02
_CANDIDATES_PER_POSE = 25
_MAX_DRAWS_PER_POSE = 400


@dataclass(frozen=True)
class Placed:
    """A candidate with joint positions that reach it.

    Attributes:
        candidate: Pose.
        q: Positions of the group, shape (n,) [rad or m].
    """

    candidate: Candidate
    q: NDArray[np.float64]


class PoseSelector:
    """Finds poses of one group that several cameras can see.

    Args:
        model: Kinematics, shapes and cameras.
        limits: Of the joints.
        checker: Of collisions.
        index: Joints of the group, shape (n,).
        frame: Its wrist.
        cameras: Cameras that shall see the light (nominal).
    """

    def __init__(
        self,
        model: Model,
        limits: JointLimits,
        checker: CollisionChecker,
        index: NDArray[np.intp],
        frame: str,
        cameras: list[Camera],
    ) -> None:
        self._model = model
        self._limits = limits
        self._checker = checker
        self._index = index
        self._cameras = cameras
        self._solver = InverseKinematics(model, limits, index, frame)
        self._home = model.cell.home

    def select(self, count: int, volume: Volume, max_tilt_rad: float, seed: int) -> list[Placed]:
        """Choose and order poses.

        Args:
            count: How many.
            volume: Where the light shall be.
            max_tilt_rad: How far the light may be turned away from the cameras' middle [rad].
            seed: Of the candidates.

        Raises:
            DataError: There are not so many.
        """
        pool = self._pool(count, volume, max_tilt_rad, seed)
        chosen = _spread([placed.candidate for placed in pool], count)
        ordered = self._order(chosen)
        if len(ordered) < count:  # some had no free way from any neighbour: others take their places
            spare = [placed.candidate for placed in pool if placed.candidate not in chosen]
            ordered = self._order([placed.candidate for placed in ordered] + spare[: 2 * (count - len(ordered))])
        if len(ordered) < count:
            raise DataError(f"only {len(ordered)} of {count} poses can be reached one after the other")
        return ordered[:count]

    def _pool(self, count: int, volume: Volume, max_tilt_rad: float, seed: int) -> list[Placed]:
        """Reachable, free and visible candidates."""
        pool: list[Placed] = []
        stream = candidates(self._model.cell, volume, self._cameras, max_tilt_rad, seed)
        for _ in range(_MAX_DRAWS_PER_POSE * count):
            placed = self._place(next(stream), self._home[self._index])
            if placed is not None:
                pool.append(placed)
                if len(pool) == _CANDIDATES_PER_POSE * count:
                    return pool
        if len(pool) < count:
            raise DataError(f"only {len(pool)} poses of {count} are reachable, free of collisions and visible")
        return pool

    def _place(self, candidate: Candidate, seed: NDArray[np.float64]) -> Placed | None:
        try:
            q = self._solver.solve(candidate.wrist, self._home, seed, self._checker)
        except ImError:
            return None
        return Placed(candidate, q) if self._seen(candidate, q) else None

    def _seen(self, candidate: Candidate, q: NDArray[np.float64]) -> bool:
        """Whether nothing stands between the light and any of the cameras."""
        whole = self._whole(q)
        for camera in self._cameras:
            towards = np.array(camera.position) - candidate.light
            start = candidate.light + towards / np.linalg.norm(towards) * _FIRST_STEP_M
            if self._checker.blocking(whole, start, np.array(camera.position), _LIGHT_RADIUS_M) is not None:
                return False
        return True

    def _order(self, chosen: list[Candidate]) -> list[Placed]:
        """From home always to the pose that is reached soonest on a free, direct way."""
        here, left, ordered = self._home[self._index], list(chosen), list[Placed]()
        while left:
            reach = [(c, self._place(c, here)) for c in left]
            ways = [(self._duration(here, p.q), k, p) for k, (_, p) in enumerate(reach) if p is not None]
            for _, k, placed in sorted(ways, key=lambda way: way[:2]):
                if self._free(here, placed.q):
                    ordered.append(placed)
                    here = placed.q
                    del left[k]
                    break
            else:
                return ordered
        return ordered

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


def _spread(pool: list[Candidate], count: int) -> list[Candidate]:
    """Candidates whose lights are far apart: each next one is the farthest from those chosen (Gonzalez, 1985)."""
    lights = np.array([candidate.light for candidate in pool])
    first = int(np.argmin(np.linalg.norm(lights - lights.mean(axis=0), axis=1)))
    chosen, distance = [first], np.linalg.norm(lights - lights[first], axis=1)
    while len(chosen) < min(count, len(pool)):
        farthest = int(np.argmax(distance))
        chosen.append(farthest)
        distance = np.minimum(distance, np.linalg.norm(lights - lights[farthest], axis=1))
    return [pool[k] for k in chosen]
