"""Shapes of the cell, and the distances between the shapes (coal, through pinocchio)."""

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_mcs.collision.surroundings import NOTHING, CollisionScene, Thing
from im_mcs.model import CellModel

NEIGHBOURS = 1


@dataclass(frozen=True)
class Closest:
    """The two closest bodies.

    Attributes:
        distance: Between their surfaces, negative if they overlap [m].
        first, second: Names of their links.
        place: Point between them in ``world``, shape (3,) [m].
    """

    distance: float
    first: str
    second: str
    place: NDArray[np.float64]


class Bodies:
    """Shapes of all links and the boxes fixed to the world, at one position of the joints after the other.

    A link has its hulls, or without them its capsules.

    Links with one joint between them are not compared: their shapes overlap by construction. Nor are the pairs that the
    cell names, in `never` or an SRDF.

    Attributes:
        names: Link or box of each body.
        pairs: Ranks of the bodies that are compared, shape (p, 2).

    Args:
        model: Kinematics and shapes.
        around: What is there beside the cell's own shapes, and which pairs are not compared: they may touch.
    """

    def __init__(self, model: CellModel, around: CollisionScene = NOTHING) -> None:
        self._model = model
        self._geometry = pin.GeometryModel()
        self.names: list[str] = []
        for number, hull in enumerate(model.cell.hulls):
            frame = model.pin.frames[model.frame_id(hull.link)]
            shape = hull_of(np.array(hull.points))
            shape.setSweptSphereRadius(hull.radius)
            self._add(f"{hull.link}_hull_{number}", hull.link, frame.parentJoint, frame.placement, shape)
        for number, capsule in enumerate(model.cell.capsules_compared):
            self._add_capsule(f"{capsule.link}_{number}", capsule.link, capsule.p0, capsule.p1, capsule.radius)
        for box in model.cell.obstacles:
            shape = coal.Box(*box.size)
            self._add(box.name, box.name, 0, pin.SE3(np.eye(3), np.array(box.center)), shape)
        for thing in around.things:
            self._add_thing(thing)
        self._never = model.cell.untouching | around.allowed
        self._add_pairs()
        self.pairs = np.array(
            [(pair.first, pair.second) for pair in self._geometry.collisionPairs], dtype=np.intp
        ).reshape(-1, 2)
        self._data = model.pin.createData()
        self._results = pin.GeometryData(self._geometry)

    @property
    def ends(self) -> list[tuple[int, NDArray[np.float64]]]:
        """Joint of each body (0: the world), ends of its line or corners in the joint's frame, shape (k, 3) [m]."""
        found = []
        for body in self._geometry.geometryObjects:
            half = body.geometry.halfLength if isinstance(body.geometry, coal.Capsule) else 0.0
            line = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
            if isinstance(body.geometry, coal.Convex):
                line = np.array(body.geometry.points())
            placement = body.placement
            found.append((int(body.parentJoint), line @ placement.rotation.T + placement.translation))
        return found

    def place(self, q: NDArray[np.float64]) -> None:
        """Place the bodies for ``q``, shape (n,)."""
        pin.updateGeometryPlacements(self._model.pin, self._data, self._geometry, self._results, q)

    def distance(self, pair: int) -> float:
        """Return the distance of a pair at the last placement, negative for an overlap [m]."""
        return float(pin.computeDistance(self._geometry, self._results, pair).min_distance)

    def closest(self, among: NDArray[np.bool_] | None = None) -> Closest:
        """The closest pair where the bodies were placed last; endlessly far, without names, where there is no pair.

        Args:
            among: Which pairs count, shape (pairs,); None: all.
        """
        if not len(self.pairs):
            return Closest(np.inf, "", "", np.zeros(3))
        pin.computeDistances(self._geometry, self._results)
        distances = np.array([result.min_distance for result in self._results.distanceResults])
        if among is not None:
            distances[~among] = np.inf
        k = int(np.argmin(distances))
        result = self._results.distanceResults[k]
        place = (np.asarray(result.getNearestPoint1()) + np.asarray(result.getNearestPoint2())).ravel() / 2.0
        return Closest(float(distances[k]), *self.pair_names(k), place)

    def pair_names(self, pair: int) -> tuple[str, str]:
        """Return links or boxes of a pair."""
        first, second = self.pairs[pair]
        return self.names[first], self.names[second]

    def joints_between(self, pair: int) -> int:
        """Return the number of joints between the bodies of a pair, along the tree."""
        first, second = (self._geometry.geometryObjects[int(body)].parentJoint for body in self.pairs[pair])
        return self._chain_distance(first, second)

    def touching(self, start: NDArray[np.float64], end: NDArray[np.float64], radius: float) -> str | None:
        """Return a link or box in touch with a thick line in ``world`` at the last placement.

        Args:
            start: Shape (3,) [m].
            end: Shape (3,) [m].
            radius: Of the line [m].
        """
        line, placement = _capsule(start, end, radius)
        at = coal.Transform3s(placement.rotation, placement.translation)
        for name, body, there in zip(self.names, self._geometry.geometryObjects, self._results.oMg, strict=True):
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            where = coal.Transform3s(there.rotation, there.translation)
            if coal.collide(line, at, body.geometry, where, request, result):
                return name
        return None

    def _add_capsule(self, name: str, link: str, p0: tuple[float, ...], p1: tuple[float, ...], radius: float) -> None:
        shape, local = _capsule(np.array(p0), np.array(p1), radius)
        frame = self._model.pin.frames[self._model.frame_id(link)]
        self._add(name, link, frame.parentJoint, frame.placement * local, shape)

    def _add_thing(self, thing: Thing) -> None:
        """Add a free body; a carried one as the capsule around the body: levers are those of a line."""
        frame = self._model.pin.frames[self._model.frame_id("universe" if thing.frame == "world" else thing.frame)]
        middle = frame.placement * pin.XYZQUATToSE3(np.array(thing.pose, dtype=np.float64))
        half = 0.5 * np.array(thing.size)
        if frame.parentJoint == 0 and thing.kind == "box":
            self._add(f"thing {thing.name}", thing.name, 0, middle, coal.Box(*thing.size))
            return
        if thing.kind == "cylinder":
            along, radius = np.array([0.0, 0.0, half[2]]), half[0]
        else:
            along = np.where(np.arange(3) == half.argmax(), half, 0.0)
            radius = float(np.linalg.norm(half - along))
        shape, local = _capsule(-along, along, radius)
        self._add(f"thing {thing.name}", thing.name, frame.parentJoint, middle * local, shape)

    def _add(self, name: str, link: str, joint: int, placement: pin.SE3, shape: coal.CollisionGeometry) -> None:
        self._geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, shape))
        self.names.append(link)

    def _add_pairs(self) -> None:
        objects = self._geometry.geometryObjects
        for i in range(len(objects)):
            for j in range(i + 1, len(objects)):
                a, b = objects[i].parentJoint, objects[j].parentJoint
                never = frozenset((self.names[i], self.names[j])) in self._never
                if not never and self._chain_distance(a, b) > NEIGHBOURS:
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))

    def _chain_distance(self, a: int, b: int) -> int:
        """Joints between two bodies along the tree; the world is joint 0."""
        if a == b:
            return 0
        up_a, up_b = ancestors(self._model, a), ancestors(self._model, b)
        if a == 0 or b == 0:
            return max(len(up_a), len(up_b)) - 1
        if up_a[-2] != up_b[-2]:  # different arms
            return len(up_a) + len(up_b)
        return abs(len(up_a) - len(up_b))


def ancestors(model: CellModel, joint: int) -> list[int]:
    """Return a joint of pinocchio's model and all the carriers, the world (0) last."""
    chain = [joint]
    while chain[-1] != 0:
        chain.append(int(model.pin.parents[chain[-1]]))
    return chain


def hull_of(points: NDArray[np.float64]) -> coal.Convex:
    """Return the convex hull of points.

    Args:
        points: Shape (n, 3), not in one plane: Qhull would end the process [m].
    """
    corners = coal.StdVec_Vec3s()
    corners.extend(list(points))
    return coal.Convex.convexHull(corners, True, "Qt")


def faces_of(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the triangles of the convex hull of points, shape (k, 3, 3): corners counter-clockwise from outside [m].

    Args:
        points: Shape (n, 3), not in one plane [m].
    """
    hull = hull_of(points)
    ranks = np.array([[hull.polygons(face)[corner] for corner in range(3)] for face in range(hull.num_polygons)])
    faces: NDArray[np.float64] = np.array(hull.points())[ranks]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    inwards = np.einsum("ij,ij->i", normals, faces[:, 0] - points.mean(axis=0)) < 0.0
    faces[inwards] = faces[inwards, ::-1]
    return faces


def _capsule(start: NDArray[np.float64], end: NDArray[np.float64], radius: float) -> tuple[coal.Capsule, pin.SE3]:
    """Return a capsule around the line from ``start`` to ``end`` and the placement."""
    length = float(np.linalg.norm(end - start))
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (end - start) / length).matrix()
    return coal.Capsule(radius, length), pin.SE3(rotation, (start + end) / 2.0)
