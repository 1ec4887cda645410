"""Capsules around the shapes of links."""

from collections.abc import Sequence
from pathlib import Path

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from im_cell.robot import Capsule, Cell
from im_cell.robot.cell import resolved
from im_cell.robot.description import UrdfGeometry, UrdfLink
from im_cell.robot.parameters import THINNEST_M, thickness
from im_cell.rotations import matrix_of_rpy
from im_core.errors import DataError

_CENTRING = 256
_SHORTEST_M = 1e-3
_LARGEST_M = 20.0
_TURN = 24


def capsule_around(link: UrdfLink, urdf: Path) -> Capsule | None:
    """Return a capsule around all collision shapes of a link; None without a shape.

    Raises:
        DataError: A mesh is not there, cannot be read, or is as large as one in millimetres.
    """
    if not link.shapes:
        return None
    found = [corners_of(shape, link.name, urdf) @ matrix_of_rpy(shape.rpy).T + shape.xyz for shape in link.shapes]
    start, end, radius = enclose(np.vstack(found))
    return Capsule(
        link=link.name, p0=_rounded(start), p1=_rounded(end), radius=round(float(np.ceil(1e3 * radius + 0.1)) * 1e-3, 3)
    )


def enclose(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return ends and radius of a small capsule around points, shape (n, 3) [m].

    The axis is the best of the points' principal axes and those of the frame, through the centre of a circle around
    them (M. Badoiu, K.L. Clarkson, "Smaller core-sets for balls", 2003).
    """
    _, _, principal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    return min(
        (_along(points, axis) for axis in (*principal, *np.eye(3))), key=lambda capsule: capsule_volume(*capsule)
    )


def _along(
    points: NDArray[np.float64], axis: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    across = points - np.outer(points @ axis, axis)
    centre = across.mean(axis=0)
    for k in range(1, _CENTRING):
        centre = centre + (across[np.argmax(np.linalg.norm(across - centre, axis=1))] - centre) / (k + 1)
    away = np.linalg.norm(across - centre, axis=1)
    radius = float(away.max())
    along, bulge = points @ axis, np.sqrt(np.maximum(radius**2 - away**2, 0.0))
    low, high = float((along + bulge).min()), float((along - bulge).max())
    if high - low < _SHORTEST_M:
        low, high = (low + high - _SHORTEST_M) / 2.0, (low + high + _SHORTEST_M) / 2.0
        ends = centre + np.outer([low, high], axis)
        spread = np.clip((points - ends[0]) @ axis, 0.0, high - low)
        radius = float(np.linalg.norm(points - ends[0] - np.outer(spread, axis), axis=1).max())
    return centre + low * axis, centre + high * axis, radius


def capsule_volume(start: ArrayLike, end: ArrayLike, radius: float) -> float:
    """Return the volume of a capsule around the line from ``start`` to ``end``, shape (3,) each [m3]."""
    return float(np.pi * radius**2 * (np.linalg.norm(np.subtract(end, start)) + 4.0 / 3.0 * radius))


def corners_of(shape: UrdfGeometry, link: str, urdf: Path) -> NDArray[np.float64]:
    """Return corners of a shape, or of the convex hull of a mesh, in its own frame, shape (n, 3) [m].

    Args:
        shape: The shape; a cylinder or sphere has the corners of a prism around it.
        link: Its link, for messages.
        urdf: File that it is from, for the paths of meshes.

    Raises:
        DataError: A mesh is not there, cannot be read, or is as large as one in millimetres.
    """
    if shape.kind == "mesh":
        return _vertices(shape, link, urdf)
    if shape.kind == "box":
        corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
        return np.asarray(corners * shape.size)
    turns = np.linspace(0.0, 2.0 * np.pi, _TURN, endpoint=False)
    circle = shape.size[0] / np.cos(np.pi / _TURN) * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    half = shape.size[1] / 2.0 if shape.kind == "cylinder" else shape.size[0]
    return np.vstack([np.column_stack([circle, np.full(_TURN, height)]) for height in (-half, half)])


def _vertices(shape: UrdfGeometry, link: str, urdf: Path) -> NDArray[np.float64]:
    try:
        path = resolved(shape.mesh, urdf)
        if not path.is_file():
            raise ValueError(f"{path} is not there")
        model = coal.MeshLoader().load(str(path), np.array(shape.size))
        points = np.array(model.vertices(), dtype=np.float64)
        if not np.isfinite(points).all():
            raise ValueError("a vertex is not finite")
    except (ValueError, RuntimeError) as error:
        told = " ".join(str(error).rpartition("message: ")[2].split())  # coal's has lines of its source before
        raise DataError(f"the mesh {shape.mesh} of link {link}: {told}", link=link, mesh=shape.mesh) from error
    if (size := float(np.ptp(points, axis=0).max())) > _LARGEST_M:
        text = f'is {size:.0f} m large: its lengths are millimetres, it seems; scale="0.001 0.001 0.001" mends that'
        raise DataError(f"the mesh {shape.mesh} of link {link} {text}", link=link, mesh=shape.mesh)
    points = np.unique(points, axis=0)
    return points if thickness(points) < THINNEST_M else points[ConvexHull(points).vertices]


def enclosing_capsules(cell: Cell) -> list[Capsule]:
    """Return a capsule around each link of a cell with shapes.

    Raises:
        DataError: A mesh cannot be used.
    """
    links: Sequence[UrdfLink] = tuple(cell.description.links.values())
    return [found for link in links if (found := capsule_around(link, Path(cell.urdf))) is not None]


def _rounded(point: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in point)
    return x, y, z
