"""Picture of a cell at home: shapes for collision from three sides."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from im_cell.robot import Cell
from im_core.errors import DataError
from im_mcs.model import CellModel

_KINDS = (".png", ".svg", ".pdf", ".jpg")
_VIEWS = (("x [m]", "z [m]", 0, 2), ("y [m]", "z [m]", 1, 2), ("x [m]", "y [m]", 0, 1))
_TURNS = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
_THINNEST_M = 1e-4
_CIRCLE = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])


def draw(cell: Cell, file: Path) -> None:
    """Draw the shapes that are compared, to scale, and the tips at home, from the front, the side and above.

    Raises:
        DataError: The name of the file is none of a picture.
        OSError: The file cannot be written.
    """
    if file.suffix not in _KINDS:
        raise DataError(f"{file}: the name of a picture ends in {', '.join(_KINDS)}", file=str(file))
    model = CellModel(cell)
    shapes = [
        *((hull.link, hull.points, hull.radius) for hull in cell.hulls),
        *((capsule.link, (capsule.p0, capsule.p1), capsule.radius) for capsule in cell.capsules_compared),
    ]
    colors = {link: f"C{rank % 10}" for rank, link in enumerate(dict.fromkeys(link for link, *_ in shapes))}
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    for axes, (across, up, *sides) in zip(figure.subplots(1, 3), _VIEWS, strict=True):
        for link, points, radius in shapes:
            pose = model.pose(cell.home, link)
            seen = np.array([pose.act(np.array(point))[sides] for point in points])
            axes.add_patch(Polygon(outline(seen, radius), facecolor=colors[link], edgecolor="k", lw=0.3, alpha=0.6))
        for group in cell.groups.values():
            place = model.pose(cell.home, group.tip).translation[sides]
            axes.plot(*place, "kx")
            axes.annotate(group.tip, place, fontsize=7, parse_math=False)
        axes.set(xlabel=across, ylabel=up, aspect="equal")
        axes.autoscale_view()
    figure.savefig(file, dpi=120)


def outline(points: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Return the outline of the convex hull of points in a plane, with a margin.

    Args:
        points: Shape (n, 2) [m].
        radius: Margin around, in all directions [m].

    Returns:
        Corners in order, shape (k, 2) [m].
    """
    around = (points[:, None] + max(radius, _THINNEST_M) * _CIRCLE).reshape(-1, 2)
    return np.asarray(around[ConvexHull(around).vertices])
