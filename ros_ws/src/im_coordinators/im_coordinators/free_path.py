"""Search of paths free of collisions: RRT-Connect of OMPL on the shapes of MCS, then shortcuts.

With a tool kept upright the search runs on the positions with an upright tool, in OMPL's projected state space, and the
straight lines between these keep the limit of the tilt.

Motions are checked as a whole, not in steps: on a straight line in joint space the distance of two bodies changes by at
most the joints' travel times their levers (conservative advancement; B. Mirtich, 1996).

Source: J.J. Kuffner, S.M. LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000;
R. Geraerts, M.H. Overmars, "Creating high-quality paths for motion planning", IJRR 2007 (shortcuts).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from im_coordinators.upright import EXACT_RAD, Upright
from im_core.errors import ImError
from im_mcs.collision import NOTHING, Bodies, CollisionScene, lever_bounds
from im_mcs.model import CellModel

Array = NDArray[np.float64]

#: Farther than allowed by MCS [m]: its check samples the same line.
_MARGIN_M = 5e-4
#: Joint travel below which a motion between two free positions counts as free [rad or m].
_FINEST = 1e-3
_RANGE = 1.5
#: Of a search with the tool upright: step of a tree, between two projections too [rad or m].
_RANGE_UPRIGHT = 0.9
#: How many times farther than a step its projection may be.
_FARTHEST_UPRIGHT = 5.0
_SHORTCUTS = 80
#: Checks of motions after which a search gives up; with the tool upright each costs many projections.
_MOST_CHECKS, _MOST_CHECKS_UPRIGHT = 3_000, 500


class FreeSpace:
    """Positions of some joints in which the bodies keep their distance.

    Args:
        model: Kinematics and shapes.
        lower, upper: Limits of those that move, shape (k,) [rad or m].
        clearance_m: Smallest distance allowed [m].
        q_all: Positions of all joints; those not in ``index`` stay, shape (n,) [rad or m].
        index: Joints that move, shape (n,).
        around: What is there beside the cell's own shapes, and which pairs may touch.
        upright: Limit of the tilt of a tool, if there is one.

    Attributes:
        upright: As given.
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
        upright: Upright | None = None,
    ) -> None:
        self._bodies, self.upright = Bodies(model, around), upright
        levers = lever_bounds(model, self._bodies)[:, index]
        # pairs at rest to each other are as they are, and nothing here can part them
        self._pairs = np.flatnonzero(levers.any(axis=1))
        self._levers = levers[self._pairs]
        self._least = np.full(len(self._pairs), clearance_m + _MARGIN_M)
        if upright is not None:  # the last "pair": an angle in place of a distance
            self._levers = np.vstack([self._levers, upright.levers()[index]])
            self._least = np.append(self._least, -upright.limit)
        self._all = np.arange(len(self._least))
        self._whole, self._index = q_all.copy(), index
        self.lower, self.upper = lower, upper
        self.checks = 0

    def room(self, q: Array, pairs: NDArray[np.intp]) -> Array | None:
        """Return how much farther apart than allowed some pairs are at ``q``, shape (k,) [m]; None if one is too close.

        Args:
            q: Shape (n,) [rad or m].
            pairs: Ranks among those that the joints move, shape (k,); one more is the tilt [rad].
        """
        self._whole[self._index] = q
        if (pairs < len(self._pairs)).any():
            self._bodies.place(self._whole)
        found = np.empty(len(pairs))
        for rank in (-1, *range(len(pairs) - 1))[: len(pairs)]:  # the last one first: a tilt is soon found
            found[rank] = room = self._apart(int(pairs[rank])) - self._least[pairs[rank]]
            if room <= 0.0:
                return None
        return found

    def _apart(self, pair: int) -> float:
        """Return the distance of a pair where the bodies were placed last [m]; of the tilt the negative angle [rad]."""
        if self.upright is None or pair < len(self._pairs):
            return self._bodies.distance(int(self._pairs[pair]))
        return -self.upright.tilt(self._whole)

    def leave(self, q: Array) -> None:
        """Let pairs too close at ``q``, shape (n,), but without contact, stay as close.

        The collision watch stops arms closer to each other than a path may lead: they must be able to leave.
        """
        self._whole[self._index] = q
        self._bodies.place(self._whole)
        apart = np.array([self._apart(pair) for pair in range(len(self._all))]) - _MARGIN_M
        self._least = np.where(apart > 0.0, np.minimum(self._least, apart), self._least)

    def tilt(self, q: Array) -> float:
        """Return the tilt of the tool at ``q``, shape (n,); 0 where it has no limit [rad]."""
        self._whole[self._index] = q
        return 0.0 if self.upright is None else self.upright.tilt(self._whole)

    def projected(self, q: Array) -> Array | None:
        """Return positions near ``q``, shape (n,), with the tool upright; None where none are found."""
        if self.upright is None:
            return q
        self._whole[self._index] = q
        return self.upright.project(self._whole, self._index, self.lower, self.upper)

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


def find_path(space: FreeSpace, start: Array, goals: Sequence[Array], seed: int) -> FreePath:
    """Find a free path to one of some goals; the same arguments and seed give the same path.

    Args:
        space: Where it is searched.
        start: Shape (n,) [rad or m].
        goals: Any of them will do, the first one that a straight line leads to first; shape (n,) each [rad or m].
        seed: Of the search.

    Raises:
        ImError: Start or goals are not free, or no path was found (code ``collision``); or the tool leans too far there
            (code ``limit``).
    """
    _require_upright(space, "start", [start])
    _require_upright(space, "goal", goals)
    free = _free_ones(space, "goal", goals)
    space.leave(start)
    _free_ones(space, "start", [start])
    straight = next((goal for goal in free if space.line_free(start, goal)), None)
    points = _connect(space, start, free, seed) if straight is None else [start, straight]
    return FreePath(np.array(_shortened(space, points, seed)[1:]), space.checks)


def _require_upright(space: FreeSpace, end: str, positions: Sequence[Array]) -> None:
    """Check for an end of a path with the tool within the limit of the tilt.

    Raises:
        ImError: In all of them it does (code ``limit``).
    """
    if space.upright is None:
        return
    least, limit = min(space.tilt(q) for q in positions), space.upright.limit
    if least >= limit:
        told = f"leans {np.degrees(least):.1f} degrees from upright at the {end} of the path"
        text = f"the tool {told}, and is to keep below {np.degrees(limit):.1f}"
        raise ImError(text, code="limit", end=end, value=least, limit=limit)


def _free_ones(space: FreeSpace, end: str, positions: Sequence[Array]) -> list[Array]:
    """Return the free ones of positions where a path may begin or end.

    Raises:
        ImError: None is free (code ``collision``).
    """
    if not (found := [q for q in positions if space.free(q)]):
        text = f"the {end} of the path is too close to something; no path is free there"
        raise ImError(text, code="collision", end=end)
    return found


def _connect(space: FreeSpace, start: Array, goals: Sequence[Array], seed: int) -> list[Array]:
    """Search by RRT-Connect."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed + 1)
    n, ends = len(start), np.array([start, *goals])
    plain, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    space.lower, space.upper = np.minimum(space.lower, ends.min(axis=0)), np.maximum(space.upper, ends.max(axis=0))
    for joint in range(n):
        bounds.setLow(joint, float(space.lower[joint]))
        bounds.setHigh(joint, float(space.upper[joint]))
    plain.setBounds(bounds)

    class Projection(base.Constraint):  # type: ignore[misc]  # bindings without types
        """Constraint of the positions of a search: the tool is upright."""

        def function(self, x: Array, out: Array) -> None:
            """Write by how much positions are off, shape (1,) [rad]."""
            out[0] = space.tilt(x)

        def project(self, x: Array) -> bool:
            """Move positions to upright ones nearby."""
            found = space.projected(x)
            if found is not None:
                x[:] = found
            return found is not None

    if space.upright is None:
        states, information = plain, base.SpaceInformation(plain)
    else:
        states = base.ProjectedStateSpace(plain, Projection(n, 1, EXACT_RAD))
        information = base.ConstrainedSpaceInformation(states)
        states.setDelta(_RANGE_UPRIGHT)
        states.setLambda(_FARTHEST_UPRIGHT)

    def position(state: "base.State") -> Array:
        return np.array([state[joint] for joint in range(n)])

    class LineCheck(base.MotionValidator):  # type: ignore[misc]  # bindings without types
        """Validator of the straight lines of a search."""

        def checkMotion(self, first: "base.State", second: "base.State", *_: object) -> bool:
            """Whether the line between two states is free."""
            return space.line_free(position(first), position(second))

    def state_at(q: Array) -> "base.State":
        state = states.allocState()
        if space.upright is not None:
            state.copy(q.tolist())
            return state
        for joint in range(n):
            state[joint] = float(q[joint])
        return state

    setup = geometric.SimpleSetup(information)
    validator = LineCheck(information)
    information.setMotionValidator(validator)
    setup.setStateValidityChecker(lambda state: space.free(position(state)))
    setup.addStartState(state_at(start))
    region = base.GoalStates(information)
    for goal in goals:
        region.addState(state_at(goal))
    setup.setGoal(region)
    planner = geometric.RRTConnect(information)
    most, reach = (_MOST_CHECKS, _RANGE) if space.upright is None else (_MOST_CHECKS_UPRIGHT, _RANGE_UPRIGHT)
    planner.setRange(reach)
    setup.setPlanner(planner)
    setup.solve(base.PlannerTerminationCondition(lambda: space.checks > most))
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
