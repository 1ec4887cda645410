"""Search of paths free of collisions: RRT-Connect of OMPL on the shapes of MCS, then shortcuts.

Motions are checked as a whole, not in steps: on a straight line in joint space the distance of two bodies changes by at
most the joints' travel times their levers (conservative advancement; B. Mirtich, 1996).

Source: J.J. Kuffner, S.M. LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000;
R. Geraerts, M.H. Overmars, "Creating high-quality paths for motion planning", IJRR 2007 (shortcuts).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.collision import NOTHING, Bodies, CollisionScene, lever_bounds
from im_mcs.model import CellModel

Array = NDArray[np.float64]

#: Farther than allowed by MCS [m]: its check samples the same line.
_MARGIN_M = 5e-4
#: Joint travel below which a motion between two free positions counts as free [rad or m].
_FINEST = 1e-3
_RANGE = 1.5
_SHORTCUTS = 80
#: Checks of motions after which a search gives up.
_MOST_CHECKS = 3_000


class FreeSpace:
    """Positions of some joints in which the bodies keep their distance.

    Args:
        model: Kinematics and shapes.
        lower, upper: Limits of those that move, shape (k,) [rad or m].
        clearance_m: Smallest distance allowed [m].
        q_all: Positions of all joints; those not in ``index`` stay, shape (n,) [rad or m].
        index: Joints that move, shape (n,).
        around: What is there beside the cell's own shapes, and which pairs may touch.

    Attributes:
        checks: How many motions were checked so far.
    """

    def __init__(
        self,
        model: CellModel,
        lower: Array,
        upper: Array,
        clearance_m: float,
        q_all: Array,
        index: NDArray[np.intp],
        around: CollisionScene = NOTHING,
    ) -> None:
        self._bodies = Bodies(model, around)
        levers = lever_bounds(model, self._bodies)[:, index]
        # pairs at rest to each other are as they are, and nothing here can part them
        self._pairs = np.flatnonzero(levers.any(axis=1))
        self._levers = levers[self._pairs]
        self._all = np.arange(len(self._pairs))
        self._least = np.full(len(self._pairs), clearance_m + _MARGIN_M)
        self._whole, self._index = q_all.copy(), index
        self.lower, self.upper = lower, upper
        self.checks = 0

    def room(self, q: Array, pairs: NDArray[np.intp]) -> Array | None:
        """Return how much farther apart than allowed some pairs are at ``q``, shape (k,) [m]; None if one is too close.

        Args:
            q: Shape (n,) [rad or m].
            pairs: Ranks among those that the joints move, shape (k,).
        """
        self._whole[self._index] = q
        self._bodies.place(self._whole)
        found = np.empty(len(pairs))
        for rank, pair in enumerate(pairs.tolist()):
            found[rank] = room = self._bodies.distance(int(self._pairs[pair])) - self._least[pair]
            if room <= 0.0:
                return None
        return found

    def leave(self, q: Array) -> None:
        """Let pairs too close at ``q``, shape (n,), but without contact, stay as close.

        The collision watch stops arms closer to each other than a path may lead: they must be able to leave.
        """
        self._whole[self._index] = q
        self._bodies.place(self._whole)
        apart = np.array([self._bodies.distance(int(pair)) for pair in self._pairs]) - _MARGIN_M
        self._least = np.where(apart > 0.0, np.minimum(self._least, apart), self._least)

    def free(self, q: Array) -> bool:
        """Whether ``q``, shape (n,), is free."""
        return self.room(q, self._all) is not None

    def line_free(self, start: Array, end: Array) -> bool:
        """Whether the straight line between two positions, shape (n,), is free; both ends included."""
        self.checks += 1
        parts = [(start, end, self._all)]
        while parts:
            later = []
            for a, b, pairs in parts:  # the middles of all parts first: what is in the way is found early
                half = 0.5 * np.abs(b - a)
                middle = 0.5 * (a + b)
                room = self.room(middle, pairs)
                if room is None:
                    return False
                near = pairs[room <= self._levers[pairs] @ half]
                if len(near) and half.max() > _FINEST:
                    later += [(a, middle, near), (middle, b, near)]
            parts = later
        return True


@dataclass(frozen=True)
class FreePath:
    """A free path.

    Attributes:
        points: Behind the start, the last one is the goal, shape (m, n) [rad or m].
        checks: Motions that were checked for it.
    """

    points: Array
    checks: int


def find_path(space: FreeSpace, start: Array, goal: Array, seed: int) -> FreePath:
    """Find a free path; the same arguments and seed give the same path.

    Args:
        space: Where it is searched.
        start: Shape (n,) [rad or m].
        goal: Shape (n,) [rad or m].
        seed: Of the search.

    Raises:
        ImError: Start or goal is not free, or no path was found (code ``collision``).
    """
    for name, q in (("goal", goal), ("start", start)):
        if q is start:
            space.leave(start)
        if not space.free(q):
            text = f"the {name} of the path is too close to something; no path is free there"
            raise ImError(text, code="collision", end=name)
    points = [start, goal] if space.line_free(start, goal) else _connect(space, start, goal, seed)
    return FreePath(np.array(_shortened(space, points, seed)[1:]), space.checks)


def _connect(space: FreeSpace, start: Array, goal: Array, seed: int) -> list[Array]:
    """Search by RRT-Connect."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed + 1)
    n = len(start)
    states, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    for joint in range(n):
        bounds.setLow(joint, float(min(space.lower[joint], start[joint], goal[joint])))
        bounds.setHigh(joint, float(max(space.upper[joint], start[joint], goal[joint])))
    states.setBounds(bounds)
    setup = geometric.SimpleSetup(states)
    information = setup.getSpaceInformation()

    def position(state: "base.State") -> Array:
        return np.array([state[joint] for joint in range(n)])

    class LineCheck(base.MotionValidator):  # type: ignore[misc]  # bindings without types
        """Validator of the straight lines of a search."""

        def checkMotion(self, first: "base.State", second: "base.State", *_: object) -> bool:
            """Whether the line between two states is free."""
            return space.line_free(position(first), position(second))

    validator = LineCheck(information)
    information.setMotionValidator(validator)
    setup.setStateValidityChecker(lambda state: space.free(position(state)))
    ends = []
    for q in (start, goal):
        state = states.allocState()
        for joint in range(n):
            state[joint] = float(q[joint])
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(_RANGE)
    setup.setPlanner(planner)
    setup.solve(base.PlannerTerminationCondition(lambda: space.checks > _MOST_CHECKS))
    if not setup.haveExactSolutionPath():
        text = f"no free path was found from where the arm is; {space.checks} motions were checked"
        raise ImError(text, code="collision", checks=space.checks)
    return [position(state) for state in setup.getSolutionPath().getStates()]


def _shortened(space: FreeSpace, points: list[Array], seed: int) -> list[Array]:
    """Replace parts of a path by straight lines, from random place to random place, as long as these are free."""
    random = np.random.Generator(np.random.Philox(seed))
    for _ in range(_SHORTCUTS if len(points) > 2 else 0):
        lengths = np.array([np.linalg.norm(b - a) for a, b in pairwise(points)])
        along = np.append(0.0, np.cumsum(lengths))
        first, last = np.sort(random.uniform(0.0, along[-1], 2))
        i, j = (int(np.clip(np.searchsorted(along, s, side="right") - 1, 0, len(lengths) - 1)) for s in (first, last))
        if i == j:
            continue
        a = points[i] + (points[i + 1] - points[i]) * (first - along[i]) / lengths[i]
        b = points[j] + (points[j + 1] - points[j]) * (last - along[j]) / lengths[j]
        if np.linalg.norm(b - a) < 0.999 * (last - first) and space.line_free(a, b):
            points = [*points[: i + 1], a, b, *points[j + 1 :]]
    for rank in range(len(points) - 2, 0, -1):
        if space.line_free(points[rank - 1], points[rank + 1]):
            del points[rank]
    return points
