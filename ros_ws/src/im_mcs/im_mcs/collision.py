"""Collision detector (paper, section 4: integrated "with no modification to the existent MCS core functions")."""

from dataclasses import dataclass
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.model import Model

_STEP_RAD = 0.03
_STEP_M = 0.015
_NEVER_TOUCHING = 2


@dataclass(frozen=True)
class Closest:
    """The two bodies that are closest to each other.

    Attributes:
        distance: Between their surfaces, negative if they overlap [m].
        first, second: Names of their links.
        place: Point between them in ``world``, shape (3,) [m].
    """

    distance: float
    first: str
    second: str
    place: NDArray[np.float64]


class CollisionChecker:
    """Distances between the capsules of all links and the boxes that are fixed to the world.

    Links at most two joints apart are not compared: their shapes overlap by construction, and the joints' limits keep
    them from touching otherwise.

    Args:
        model: Kinematics and shapes.
        clearance_m: Smallest distance allowed [m].
    """

    def __init__(self, model: Model, clearance_m: float) -> None:
        self._model = model
        self._clearance = clearance_m
        self._step = np.array([_STEP_M if joint.kind == "prismatic" else _STEP_RAD for joint in model.cell.joints])
        self._geometry = pin.GeometryModel()
        self._links: list[str] = []
        for number, capsule in enumerate(model.cell.capsules):
            self._add_capsule(f"{capsule.link}_{number}", capsule.link, capsule.p0, capsule.p1, capsule.radius)
        for box in model.cell.obstacles:
            shape = coal.Box(*box.size)
            self._add(box.name, box.name, 0, pin.SE3(np.eye(3), np.array(box.center)), shape)
        self._add_pairs()
        self._data = model.pin.createData()
        self._results = pin.GeometryData(self._geometry)

    @property
    def pairs(self) -> int:
        """How many pairs of bodies are compared."""
        return len(self._geometry.collisionPairs)

    def closest(self, q: NDArray[np.float64]) -> Closest:
        """The closest pair at ``q``, shape (18,)."""
        pin.computeDistances(self._model.pin, self._data, self._geometry, self._results, q)
        distances = [result.min_distance for result in self._results.distanceResults]
        k = int(np.argmin(distances))
        pair = self._geometry.collisionPairs[k]
        result = self._results.distanceResults[k]
        place = (np.asarray(result.getNearestPoint1()) + np.asarray(result.getNearestPoint2())).ravel() / 2.0
        return Closest(float(distances[k]), self._links[pair.first], self._links[pair.second], place)

    def require_free(self, q: NDArray[np.float64], where: str = "") -> float:
        """Smallest distance at ``q``, shape (18,) [m].

        Raises:
            ImError: Two bodies are closer than the clearance; both are named (code ``collision``).
        """
        closest = self.closest(q)
        if closest.distance >= self._clearance:
            return closest.distance
        x, y, z = closest.place
        verb = "would collide with" if closest.distance <= 0.0 else "would come too close to"
        raise ImError(
            f"{where}{': ' if where else ''}{closest.first} {verb} {closest.second} at ({x:.2f}, {y:.2f}, {z:.2f}) m: "
            f"distance {closest.distance * 1e3:.0f} mm, {self._clearance * 1e3:.0f} mm is the least allowed",
            code="collision",
            first=closest.first,
            second=closest.second,
            distance_m=closest.distance,
            clearance_m=self._clearance,
        )

    def check_path(self, q_all: NDArray[np.float64], index: NDArray[np.intp], points: NDArray[np.float64]) -> float:
        """Check the straight lines in joint space through ``points``.

        Args:
            q_all: Positions of all joints; those of other groups stay, shape (18,).
            index: Joints of the group, shape (n,).
            points: Points of the path, the first is where the group is, shape (m, n).

        Returns:
            Smallest distance on the way [m].

        Raises:
            ImError: Two bodies come too close; pair, point and place are named (code ``collision``).
        """
        whole = q_all.copy()
        whole[index] = points[0]
        clearance = self.require_free(whole, "at the start")
        for number, (a, b) in enumerate(pairwise(points), start=1):
            steps = max(1, int(np.ceil(np.max(np.abs(b - a) / self._step[index]))))
            for k in range(1, steps + 1):
                whole[index] = a + (b - a) * (k / steps)
                where = f"on the way to point {number} ({100 * k // steps} %)" if k < steps else f"at point {number}"
                clearance = min(clearance, self.require_free(whole, where))
        return clearance

    def blocking(
        self, q: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64], radius: float
    ) -> str | None:
        """Link or obstacle in the way of a thick straight line, if there is one.

        Args:
            q: Positions of all joints, shape (18,).
            start: In ``world``, shape (3,) [m].
            end: In ``world``, shape (3,) [m].
            radius: Of the line [m].
        """
        line, placement = _capsule(start, end, radius)
        at = coal.Transform3s(placement.rotation, placement.translation)
        pin.updateGeometryPlacements(self._model.pin, self._data, self._geometry, self._results, q)
        for k, body in enumerate(self._geometry.geometryObjects):
            there = self._results.oMg[k]
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            if coal.collide(
                line, at, body.geometry, coal.Transform3s(there.rotation, there.translation), request, result
            ):
                return self._links[k]
        return None

    def _add_capsule(self, name: str, link: str, p0: tuple[float, ...], p1: tuple[float, ...], radius: float) -> None:
        shape, local = _capsule(np.array(p0), np.array(p1), radius)
        frame = self._model.pin.frames[self._model.frame_id(link)]
        self._add(name, link, frame.parentJoint, frame.placement * local, shape)

    def _add(self, name: str, link: str, joint: int, placement: pin.SE3, shape: coal.CollisionGeometry) -> None:
        self._geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, shape))
        self._links.append(link)

    def _add_pairs(self) -> None:
        objects = self._geometry.geometryObjects
        for i in range(len(objects)):
            for j in range(i + 1, len(objects)):
                a, b = objects[i].parentJoint, objects[j].parentJoint
                if self._chain_distance(a, b) > _NEVER_TOUCHING:
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))

    def _chain_distance(self, a: int, b: int) -> int:
        """Joints between two bodies along the tree; the world is joint 0."""
        if a == b:
            return 0
        up_a, up_b = self._ancestors(a), self._ancestors(b)
        if a == 0 or b == 0:
            return max(len(up_a), len(up_b)) - 1
        if up_a[-2] != up_b[-2]:  # different arms
            return len(up_a) + len(up_b)
        return abs(len(up_a) - len(up_b))

    def _ancestors(self, joint: int) -> list[int]:
        chain = [joint]
        while chain[-1] != 0:
            chain.append(int(self._model.pin.parents[chain[-1]]))
        return chain


def _capsule(start: NDArray[np.float64], end: NDArray[np.float64], radius: float) -> tuple[coal.Capsule, pin.SE3]:
    """A capsule around the line from ``start`` to ``end`` and its placement."""
    length = float(np.linalg.norm(end - start))
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (end - start) / length).matrix()
    return coal.Capsule(radius, length), pin.SE3(rotation, (start + end) / 2.0)
