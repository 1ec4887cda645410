"""Maps of the errors to expect over the workspace."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from numpy.typing import NDArray

from im_vss.calibration.expected import ExpectedError

Array = NDArray[np.float64]


def draw_expected(figure: FigureBase, expected: ExpectedError) -> None:
    """Draw both errors from above and from the side, each RMS over the axis that is looked along.

    Args:
        figure: An empty figure, or part of one.
        expected: The map; an error that is nowhere defined (triangulation by one camera) is left out.
    """
    errors = (
        ("Triangulation", expected.triangulation_mm, expected.triangulation_rms_mm, "mm"),
        ("Reprojection", expected.reprojection_px, expected.reprojection_rms_px, "px"),
    )
    known = [error for error in errors if not np.isnan(error[2])]
    for column, (name, values, whole, unit) in enumerate(known):
        for row, third in enumerate((2, 1)):
            axes = figure.add_subplot(2, len(known), row * len(known) + column + 1)
            _draw_map(figure, axes, expected.points, values, third, unit)
            seen_from = "from above" if third == 2 else "from the side"
            axes.set_title(f"{name}, {seen_from}" + f"; {whole:.3g} {unit} RMS" * (row == 0), fontsize=9)


def _draw_map(figure: FigureBase, axes: Axes, points: Array, values: Array, third: int, unit: str) -> None:
    """Map of an error over two axes of the workspace, RMS over the third."""
    i, j = (axis for axis in range(3) if axis != third)
    across, up = np.unique(points[:, i]), np.unique(points[:, j])
    column, row = np.searchsorted(across, points[:, i]), np.searchsorted(up, points[:, j])
    shape, known = (len(up), len(across)), ~np.isnan(values)
    squares, counts = np.zeros(shape), np.zeros(shape)
    np.add.at(squares, (row[known], column[known]), values[known] ** 2)
    np.add.at(counts, (row[known], column[known]), 1.0)
    picture = axes.pcolormesh(across, up, np.sqrt(squares / np.where(counts > 0.0, counts, np.nan)), cmap="viridis")
    figure.colorbar(picture, ax=axes, shrink=0.85, label=f"RMS over {'xyz'[third]} [{unit}]")
    axes.set(aspect="equal", xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]")
    axes.tick_params(labelsize=8)
