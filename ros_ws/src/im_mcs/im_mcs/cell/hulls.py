"""Convex hulls around the shapes of links, of few corners."""

from pathlib import Path

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from im_cell.robot import Cell, Hull
from im_cell.robot.description import UrdfLink
from im_cell.robot.parameters import THINNEST_M, thickness
from im_cell.rotations import matrix_of_rpy
from im_mcs.cell.capsules import corners_of
from im_mcs.collision.bodies import hull_of

_MOST_CORNERS, _NEAR_M = 32, 1e-3
_ROUNDED_M = 1e-4
_POINT_M, _THIN_M = 1e-9, 1e-3


def hulls_around(link: UrdfLink, urdf: Path) -> list[Hull]:
    """Return a hull around each shape of a link, if one of them is a mesh or a box; a capsule holds the others well.

    Raises:
        DataError: A mesh is not there, cannot be read, or is as large as one in millimetres.
    """
    if not any(shape.kind in ("mesh", "box") for shape in link.shapes):
        return []
    placed = [corners_of(shape, link.name, urdf) @ matrix_of_rpy(shape.rpy).T + shape.xyz for shape in link.shapes]
    if min(map(thickness, placed)) < _THIN_M:
        return []
    found = [simplified(points) for points in placed]
    return [
        Hull.model_validate({"link": link.name, "points": corners.tolist(), "radius": margin})
        for corners, margin in found
    ]


def simplified(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return some corners of the convex hull of points, and a margin for the missing corners.

    The corners are the outermost ones, then always the one farthest outside the hull of those before.

    Args:
        points: Shape (n, 3), not in one plane [m].

    Returns:
        Corners in tenths of a millimetre, shape (k, 3) [m], and the margin: their hull with it holds all points [m].
    """
    whole: NDArray[np.float64] = np.unique(points[ConvexHull(points).vertices], axis=0)
    chosen = list(dict.fromkeys([*whole.argmin(axis=0).tolist(), *whole.argmax(axis=0).tolist()]))
    while thickness(whole[chosen]) < THINNEST_M and len(chosen) < len(whole):
        normal = np.linalg.svd(whole[chosen] - whole[chosen].mean(axis=0))[2][2]
        off = np.abs((whole - whole[chosen[0]]) @ normal)
        off[chosen] = -1.0
        chosen.append(int(off.argmax()))
    while len(chosen) < min(_MOST_CORNERS, len(whole)):
        hull = hull_of(whole[chosen])
        outside = (whole @ np.array(hull.normals()).T + np.array(hull.offsets()).ravel()).max(axis=1)
        if outside.max() < _NEAR_M:
            break
        chosen.append(int(outside.argmax()))
    corners: NDArray[np.float64] = np.round(whole[chosen], 4)
    hull, point = hull_of(corners), coal.Sphere(_POINT_M)
    away = max(_distance(hull, point, each) for each in whole)
    return corners, float(np.ceil((max(away, 0.0) + _POINT_M) / _ROUNDED_M) * _ROUNDED_M)


def _distance(hull: coal.Convex, point: coal.Sphere, at: NDArray[np.float64]) -> float:
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(hull, coal.Transform3s(), point, coal.Transform3s(np.eye(3), at), request, result))


def enclosing_hulls(cell: Cell) -> list[Hull]:
    """Return the hulls around the links of a cell with meshes or boxes.

    Raises:
        DataError: A mesh cannot be used.
    """
    return [hull for link in cell.description.links.values() for hull in hulls_around(link, Path(cell.urdf))]
