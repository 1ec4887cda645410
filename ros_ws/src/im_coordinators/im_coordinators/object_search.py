"""Search for a free body: the laser sweeps what it may stand on, and its upper face is found by height and size."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_cell.laser_model import LaserModel
from im_cell.robot import Cell, FreeBody
from im_core.errors import DataError, ImError, NotFoundError

Array = NDArray[np.float64]

#: The scanner hangs where it is drawn within this, as far as the table [m].
_MARGIN_M = 0.15
#: Distance of two lines of a sweep on the table [m].
_SPACING_M = 0.015
#: Points this near in height are of the upper face; points farther apart are of different faces [m].
_HEIGHT_M, _GAP_M = 0.008, 0.025
#: Error of the length of a face: two lines, and some pixels of a camera [m].
_LENGTH_M = 0.02
_FEWEST = 6


def body_named(cell: Cell, name: str) -> FreeBody:
    """Return a free body of the cell.

    Raises:
        NotFoundError: There is none of the name.
    """
    bodies = {body.name: body for body in cell.objects}
    if name not in bodies:
        raise NotFoundError(kind="object", name=name, known=bodies)
    return bodies[name]


def height_of(cell: Cell, obstacle: str) -> float:
    """Return the height of the upper face of an obstacle [m].

    Raises:
        NotFoundError: There is none of the name.
    """
    tops = {box.name: box.center[2] + 0.5 * box.size[2] for box in cell.obstacles}
    if obstacle not in tops:
        raise NotFoundError(kind="obstacle", name=obstacle, known=tops)
    return float(tops[obstacle])


def sweep_over(cell: Cell, region: Sequence[float], height: float) -> dict[str, object]:
    """Return mirror angles and number of lines of a sweep over a region, of a scanner that hangs as drawn.

    Args:
        cell: Parameters.
        region: Smallest x and y, largest x and y, shape (4,) [m].
        height: Of the region [m].

    Raises:
        ImError: The cell has no laser, the region is none, or the beam cannot go there.
    """
    scanner = cell.laser
    if scanner is None:
        raise DataError("the cell has no laser; objects are found by its beam")
    x0, y0, x1, y1 = region
    if not (x0 < x1 and y0 < y1):
        raise DataError(f"region {list(region)}: x y of the smaller corner come before those of the larger one")
    corners = [[x, y, height] for x in (x0 - _MARGIN_M, x1 + _MARGIN_M) for y in (y0 - _MARGIN_M, y1 + _MARGIN_M)]
    angles = LaserModel(*scanner.pose(), scanner.gap).angles_to(corners)
    low, high = angles.min(axis=0), angles.max(axis=0)
    if np.abs([low[0], high[0]]).max() > scanner.range or np.abs([low[1], high[1]]).max() > scanner.range:
        low, high = np.maximum(low, -scanner.range), np.minimum(high, scanner.range)
    lines = int(np.ceil((x1 - x0 + 2.0 * _MARGIN_M) / _SPACING_M))
    span, sweep = ([float(low[mirror]), float(high[mirror])] for mirror in (0, 1))
    if not (span[0] < span[1] and sweep[0] < sweep[1]):
        raise DataError(f"region {list(region)} is out of the laser's reach", region=list(region))
    return {"span": span, "sweep": sweep, "lines": lines}


def middle_of(points: Array, body: FreeBody, ground: float, region: Sequence[float]) -> Array:
    """Return the middle of a body that stands upright, shape (3,) [m], from the points of a sweep.

    Args:
        points: Shape (n, 3) [m].
        body: What is searched.
        ground: Height on which it stands [m].
        region: Smallest x and y, largest x and y, shape (4,) [m].

    Raises:
        ImError: No face of its height and size is there (code ``not_found``), or several are.
    """
    top, size = ground + body.size[2], np.array(body.size)
    inside = np.all((points[:, :2] >= region[:2]) & (points[:, :2] <= region[2:]), axis=1)
    near = points[inside & (np.abs(points[:, 2] - top) < _HEIGHT_M)][:, :2]
    faces = [face for face in _apart(near) if len(face) >= _FEWEST and _fits(face, size)]
    if len(faces) != 1:
        found = "nothing" if not faces else f"{len(faces)} objects"
        text = (
            f"'{body.name}' was not found: of its size, {1000 * size[2]:.0f} mm high, {found} "
            f"{'stand' if len(faces) > 1 else 'stands'} in the region ({len(near)} points at that height)"
        )
        raise ImError(text, code="not_found", object=body.name, faces=len(faces))
    middle = 0.5 * (faces[0].min(axis=0) + faces[0].max(axis=0))
    return np.array([*middle, ground + 0.5 * size[2]])


def _fits(face: Array, size: Array) -> bool:
    """Whether the extents of a face, shape (n, 2), may be those of a body turned about the vertical."""
    extents = np.sort(np.ptp(face, axis=0))
    shortest, longest = min(size[:2]), float(np.hypot(*size[:2]))
    return bool(extents[0] > shortest - _LENGTH_M - 0.01 and extents[1] < longest + _LENGTH_M)


def _apart(points: Array) -> list[Array]:
    """Return groups of points, shape (m, 2), with gaps in between."""
    left, groups = list(range(len(points))), []
    while left:
        group, ends = [], [left.pop(0)]
        while ends:
            group += ends
            rest = np.array(left, dtype=np.intp)
            gaps = np.linalg.norm(points[rest, None] - points[ends], axis=2).min(axis=1) if left else np.zeros(0)
            ends = rest[gaps < _GAP_M].tolist()
            left = rest[gaps >= _GAP_M].tolist()
        groups.append(points[group])
    return groups
