"""Checks of positions and paths before anything moves."""

from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.collision.bodies import Bodies, Closest
from im_mcs.collision.monitor import lever_bounds
from im_mcs.collision.surroundings import NOTHING, CollisionScene
from im_mcs.model import CellModel

_STEP_RAD = 0.03
_STEP_M = 0.015
#: Below this bodies touch, and a motion that begins close may come closer by this much [m].
_TOUCH_M = 1e-3


class Positions(Protocol):
    """Where a motion is."""

    @property
    def q(self) -> NDArray[np.float64]:
        """Positions at some times, shape (m, n) [rad or m]."""
        ...


class PlannedMotion(Protocol):
    """Motion as a function of time."""

    @property
    def duration(self) -> float:
        """From start to end [s]."""
        ...

    def span(self, t: NDArray[np.float64]) -> Positions:
        """Return positions at times ``t``, shape (m,) [s]."""
        ...

    def point(self, t: float) -> int:
        """Return the index of the next point."""
        ...


class CollisionChecker:
    """Says whether positions and paths keep the bodies apart.

    Args:
        model: Kinematics and shapes.
        clearance_m: Smallest distance allowed [m].
        around: Free bodies, and pairs that may touch.
    """

    def __init__(self, model: CellModel, clearance_m: float, around: CollisionScene = NOTHING) -> None:
        self._model, self._bodies = model, Bodies(model, around)
        self._clearance = clearance_m
        self._step = np.array([_STEP_M if joint.kind == "prismatic" else _STEP_RAD for joint in model.cell.joints])

    @property
    def pairs(self) -> int:
        """How many pairs of bodies are compared."""
        return len(self._bodies.pairs)

    def closest(self, q: NDArray[np.float64], among: NDArray[np.bool_] | None = None) -> Closest:
        """The closest pair at ``q``, shape (n,), of all pairs or of some, shape (pairs,)."""
        self._bodies.place(q)
        return self._bodies.closest(among)

    def moved(self, index: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return which pairs some joints move, shape (pairs,); the others are at rest to each other and stay so."""
        return np.asarray(lever_bounds(self._model, self._bodies)[:, index].any(axis=1))

    def require_free(
        self,
        q: NDArray[np.float64],
        where: str = "",
        least: float | None = None,
        among: NDArray[np.bool_] | None = None,
    ) -> float:
        """Smallest distance at ``q``, shape (n,) [m].

        Args:
            q: Positions of all joints.
            where: Part of a path, for the error.
            least: Smallest distance allowed [m]; None: the clearance.
            among: Which pairs count, shape (pairs,); None: all.

        Raises:
            ImError: Two bodies are closer than that; both are named (code ``collision``).
        """
        closest, least = self.closest(q, among), self._clearance if least is None else least
        if closest.distance >= least:
            return closest.distance
        x, y, z = closest.place
        verb = "would collide with" if closest.distance <= 0.0 else "would come too close to"
        raise ImError(
            f"{where}{': ' if where else ''}{closest.first} {verb} {closest.second} at ({x:.2f}, {y:.2f}, {z:.2f}) m: "
            f"distance {closest.distance * 1e3:.0f} mm, {least * 1e3:.0f} mm is the least allowed",
            code="collision",
            first=closest.first,
            second=closest.second,
            distance_m=closest.distance,
            clearance_m=least,
        )

    def _begin(self, q: NDArray[np.float64], among: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the distance at the start, and the smallest one allowed from there to the end [m].

        The watch may stop an arm closer than the clearance: it may leave, and comes no closer on the way.

        Raises:
            ImError: Bodies touch.
        """
        distance = self.require_free(q, "at the start", _TOUCH_M, among)
        return distance, min(self._clearance, distance - _TOUCH_M)

    def check_path(self, q_all: NDArray[np.float64], index: NDArray[np.intp], points: NDArray[np.float64]) -> float:
        """Check the straight lines in joint space through ``points``.

        Args:
            q_all: Positions of all joints; those of other groups stay, shape (n,).
            index: Joints of the group, shape (n,); pairs that none of them moves do not count.
            points: Points of the path, the first is where the group is, shape (m, n).

        Returns:
            Smallest distance on the way [m].

        Raises:
            ImError: Two bodies come too close; pair, point and place are named (code ``collision``).
        """
        whole = q_all.copy()
        whole[index] = points[0]
        moved = self.moved(index)
        clearance, least = self._begin(whole, moved)
        for number, (a, b) in enumerate(pairwise(points), start=1):
            steps = max(1, int(np.ceil(np.max(np.abs(b - a) / self._step[index]))))
            for k in range(1, steps + 1):
                whole[index] = a + (b - a) * (k / steps)
                where = f"on the way to point {number} ({100 * k // steps} %)" if k < steps else f"at point {number}"
                last = k == steps and number == len(points) - 1
                clearance = min(clearance, self.require_free(whole, where, None if last else least, moved))
        return clearance

    def check_motion(
        self, q_all: NDArray[np.float64], index: NDArray[np.intp], motion: PlannedMotion, velocity: NDArray[np.float64]
    ) -> float:
        """Check a motion along the true way, straight or not.

        Args:
            q_all: Positions of all joints; those of other groups stay, shape (n,).
            index: Joints of the group, shape (n,).
            motion: As planned; it begins where the group is.
            velocity: What none of its joints exceeds, shape (n,) [rad/s or m/s].

        Returns:
            Smallest distance on the way [m].

        Raises:
            ImError: Two bodies come too close; pair, point and place are named (code ``collision``).
        """
        step, whole = self._step[index], q_all.copy()
        # half a step a sample, so that no gap between two that are looked at is longer than a step
        count = max(1, int(np.ceil(2.0 * motion.duration * float((velocity / step).max()))))
        times = np.linspace(0.0, motion.duration, count + 1)
        q = motion.span(times).q
        whole[index] = seen = q[0]
        moved = self.moved(index)
        clearance, least = self._begin(whole, moved)
        for k in range(1, count + 1):
            if k < count and (np.abs(q[k + 1] - seen) <= step).all():
                continue
            whole[index] = seen = q[k]
            number = motion.point(float(times[k])) + 1
            where = "at the end" if k == count else f"on the way to point {number} ({100 * k // count} % of the time)"
            clearance = min(clearance, self.require_free(whole, where, None if k == count else least, moved))
        return clearance

    def blocking(
        self, q: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64], radius: float
    ) -> str | None:
        """Link or obstacle in the way of a thick straight line, if there is one.

        Args:
            q: Positions of all joints, shape (n,).
            start: In ``world``, shape (3,) [m].
            end: In ``world``, shape (3,) [m].
            radius: Of the line [m].
        """
        self._bodies.place(q)
        return self._bodies.touching(start, end, radius)
