"""Places of a light within reach and in view of all cameras."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from im_core.errors import DataError
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.poses.view import View

_SAMPLES = 12000
_SEED_KEY = 20260711
# Places this near to a sampled one count as within reach: about the distance between the samples.
_NEAR_M = 0.12
# With fewer samples in view the common part of the views is hardly larger than the light.
_FEWEST = 25


class CommonView:
    """Places of a light in view of all cameras: sampled arm positions, only the ones in every image.

    Attributes:
        lower: Corner of the box around these places, shape (3,) [m].
        upper: Opposite corner, shape (3,) [m].
        wrists: Poses of the wrist in ``world`` of the samples.

    Args:
        model: Kinematics and the light.
        limits: Of the joints.
        index: Joints of the group, shape (n,).
        frame: Its wrist.
        views: The cameras.
        offset: The light in the frame of the wrist, shape (3,) [m].

    Raises:
        DataError: There is no such place; the message says which cameras have none in common.
    """

    def __init__(
        self,
        model: CellModel,
        limits: JointLimits,
        index: NDArray[np.intp],
        frame: str,
        views: Sequence[View],
        offset: NDArray[np.float64],
    ) -> None:
        draw = np.random.Generator(np.random.Philox(key=_SEED_KEY)).uniform(size=(_SAMPLES, len(index)))
        sampled = limits.lower[index] + draw * (limits.upper - limits.lower)[index]
        whole = model.cell.home
        lights, wrists = np.empty((_SAMPLES, 3)), []
        for k, q in enumerate(sampled):
            whole[index] = q
            wrists.append(model.pose(whole, frame).copy())
            lights[k] = wrists[k].act(offset)
        seen = np.array([view.sees(lights) for view in views])
        common = seen.all(axis=0)
        if common.sum() < _FEWEST:
            raise DataError(_reason(seen, [view.name for view in views], frame), cameras=[view.name for view in views])
        self.wrists = [wrists[k] for k in np.flatnonzero(common)]
        self._views = views
        self._positions, self._tree = sampled[common], cKDTree(lights[common])
        self.lower, self.upper = lights[common].min(axis=0), lights[common].max(axis=0)

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points, shape (n, 3) [m], all cameras see and the light can come near to, shape (n,)."""
        distances, _ = self._tree.query(points)
        return np.asarray((distances <= _NEAR_M) & np.all([view.sees(points) for view in self._views], axis=0))

    def start(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions of the group with the light near to a point, shape (n,) [rad or m]."""
        return np.asarray(self._positions[int(self._tree.query(point)[1])])


def _reason(seen: NDArray[np.bool_], names: Sequence[str], frame: str) -> str:
    """Return the reason of a missing common view: the fewest cameras without one."""
    for size in range(1, len(names) + 1):
        for some in combinations(range(len(names)), size):
            if seen[list(some)].all(axis=0).sum() < _FEWEST:
                named = " and ".join(f"'{names[k]}'" for k in some)
                what = f"camera {named} sees no place" if size == 1 else f"cameras {named} see no place in common"
                return f"{what} that the light on {frame} can reach"
    raise AssertionError("all cameras together have too few places in view")
