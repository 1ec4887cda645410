"""Picture of a cell at home: its bodies from three sides."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from im_cell.robot import Cell
from im_mcs.model import CellModel

_VIEWS = (("x [m]", "z [m]", 0, 2), ("y [m]", "z [m]", 1, 2), ("x [m]", "y [m]", 0, 1))


def draw(cell: Cell, file: Path) -> None:
    """Draw the axes of all capsules and the tips at home, from the front, the side and above.

    Raises:
        OSError: The file cannot be written.
    """
    model = CellModel(cell)
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    for axes, (across, up, i, j) in zip(figure.subplots(1, 3), _VIEWS, strict=True):
        for body in cell.bodies:
            pose = model.pose(cell.home, body.link)
            ends = np.array([pose.act(np.array(end)) for end in (body.p0, body.p1)])
            axes.plot(ends[:, i], ends[:, j], linewidth=3.0, marker="o", markersize=2.0)
        for group in cell.groups.values():
            place = model.pose(cell.home, group.tip).translation
            axes.plot(place[i], place[j], "kx")
            axes.annotate(group.tip, (place[i], place[j]), fontsize=7)
        axes.set(xlabel=across, ylabel=up, aspect="equal")
    figure.savefig(file, dpi=120)
