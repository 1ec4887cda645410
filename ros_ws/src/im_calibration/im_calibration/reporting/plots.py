"""Pictures of a calibration: residuals with the noise they should have, coverage, geometry."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from im_vss.calibration.calibration import Calibration
from im_vss.calibration.plot_expected import draw_expected
from im_vss.calibration.plot_scene import draw_scene
from im_vss.calibration.problem import CalibrationProblem

Array = NDArray[np.float64]

USED, REJECTED, NOISE, GRID = "#1f6fb4", "#d1495b", "#8aa6bf", "#dfe5ea"

_SIGMAS_95 = float(np.sqrt(5.991))


def plot_residuals(calibration: Calibration, problem: CalibrationProblem, target: io.BytesIO) -> None:
    """Residuals of each camera with the 95 % ellipses of the stated noise, and their lengths against chi-square.

    Args:
        calibration: The result.
        problem: What it was made from.
        target: Where the PNG goes.
    """
    count = len(calibration.cameras)
    figure = _figure(4.2 * (count + 1), 4.3)
    for c, camera in enumerate(calibration.cameras):
        axes = figure.add_subplot(1, count + 1, c + 1)
        used = calibration.used[c]
        residuals, spread = calibration.residuals[c][used], calibration.residual_covariances[c][used]
        limit = 1.15 * max(_SIGMAS_95 * np.sqrt(np.linalg.eigvalsh(spread).max()), np.abs(residuals).max())
        values, vectors = np.linalg.eigh(spread)
        sizes = 2.0 * _SIGMAS_95 * np.sqrt(values)
        angles = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
        ellipses = EllipseCollection(
            sizes[:, 1], sizes[:, 0], angles, units="xy", offsets=np.zeros_like(residuals),
            offset_transform=axes.transData, facecolors="none", edgecolors=NOISE, linewidths=0.6, alpha=0.7,
        )  # fmt: skip
        axes.add_collection(ellipses)
        axes.plot(*residuals.T, "o", color=USED, markersize=3.5, zorder=3)
        left_out = calibration.residuals[c][_left_out(calibration, problem, c)]
        outside = int(np.sum(np.any(np.abs(left_out) > limit, axis=1)))
        axes.plot(*left_out.T, "x", color=REJECTED, markersize=5, zorder=3)
        axes.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", xlabel="du [px]", ylabel="dv [px]")
        axes.locator_params(nbins=5)
        note = f", {outside} rejected beyond the frame" if outside else ""
        axes.set_title(f"{camera.name}\n{camera.spots_used} spots, {camera.rms_px:.3f} px RMS{note}", fontsize=9)
        _grid(axes)
    _plot_chi2(figure.add_subplot(1, count + 1, count + 1), calibration)
    figure.suptitle("Residuals and the 95 % ellipses of the stated image and position noise", fontsize=11)
    _save(figure, target)


def plot_coverage(calibration: Calibration, problem: CalibrationProblem, target: io.BytesIO) -> None:
    """Where the spots lie in the images, and where the LED was in the workspace.

    Args:
        calibration: The result.
        problem: What it was made from.
        target: Where the PNG goes.
    """
    count = len(calibration.cameras)
    columns = max(count, 2)
    figure = _figure(4.6 * columns, 6.7)
    grid = figure.add_gridspec(2, columns, height_ratios=(1.35, 1.0))
    for c, camera in enumerate(calibration.cameras):
        axes = figure.add_subplot(grid[0, c])
        width, height = problem.image_sizes[c]
        axes.plot(*problem.spots[c][calibration.used[c]].T, "o", color=USED, markersize=4, label="used")
        left_out = problem.spots[c][_left_out(calibration, problem, c)]
        axes.plot(*left_out.T, "x", color=REJECTED, markersize=6, label="rejected")
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="u [px]", ylabel="v [px]")
        axes.set_title(f"{camera.name}: {camera.spots_used} spots in the image", fontsize=9)
        _grid(axes)
        if c == 0:
            axes.legend(fontsize=8, loc="upper right", framealpha=0.9)
    used = calibration.used.any(axis=0)
    for column, (i, j) in enumerate(((0, 1), (0, 2))):
        axes = figure.add_subplot(grid[1, column])
        low, high = np.array(problem.workspace.low)[[i, j]], np.array(problem.workspace.high)[[i, j]]
        axes.add_patch(Rectangle((low[0], low[1]), *(high - low), fill=False, edgecolor=NOISE))
        points = calibration.led_positions[:, [i, j]]
        axes.plot(*points[used].T, "o", color=USED, markersize=4)
        axes.plot(*points[~used].T, "x", color=REJECTED, markersize=6)
        axes.set(aspect="equal", xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]")
        axes.margins(0.08)
        seen_from = "from above" if j == 1 else "from the side"
        axes.set_title(f"LED positions {seen_from}, and the workspace (frame)", fontsize=9)
        _grid(axes)
    figure.suptitle("Coverage of the images and of the workspace", fontsize=11)
    _save(figure, target)


def plot_geometry(calibration: Calibration, problem: CalibrationProblem, target: io.BytesIO) -> None:
    """Cameras, LED positions and wrist directions in space, and maps of the errors to expect.

    Args:
        calibration: The result.
        problem: What it was made from.
        target: Where the PNG goes.
    """
    figure = _figure(15.0, 7.0, gap=0.12)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.35))
    scene, maps = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    draw_scene(scene.add_subplot(projection="3d"), calibration, problem)
    draw_expected(maps, calibration.expected)
    figure.suptitle("Geometry, and the errors to expect (one standard deviation)", fontsize=11)
    _save(figure, target)


def _plot_chi2(axes: Axes, calibration: Calibration) -> None:
    """Distribution of the spots' squared Mahalanobis lengths against chi-square with 2 degrees of freedom."""
    used = calibration.used
    residuals, spread = calibration.residuals[used], calibration.residual_covariances[used]
    lengths = np.sort((residuals * np.linalg.solve(spread, residuals[..., None])[..., 0]).sum(axis=1))
    share = (np.arange(len(lengths)) + 0.5) / max(len(lengths), 1)
    curve = np.linspace(0.0, max(12.0, float(lengths[-1])), 300)
    kept = max(calibration.dof, 1) / max(2 * len(lengths), 1)
    stated = 1.0 - np.exp(-curve / 2.0 / kept)
    axes.plot(curve, stated, "-", color=NOISE, linewidth=1.5, label="stated noise, less the fit")
    axes.step(lengths, share, where="mid", color=USED, linewidth=1.2, label="spots used")
    axes.set(xlabel="squared length of a residual [sigma²]", ylabel="share of the spots below", ylim=(0.0, 1.02))
    axes.set_xlim(left=0.0)
    figures = f"chi2/dof {calibration.chi2_per_dof:.3f}, p {calibration.p_value:.2g}"
    axes.set_title(f"{figures}\n{calibration.points_used} poses", fontsize=9)
    axes.legend(fontsize=8, loc="lower right")
    _grid(axes)


def _left_out(calibration: Calibration, problem: CalibrationProblem, c: int) -> NDArray[np.bool_]:
    return np.asarray(problem.detected[c] & ~calibration.used[c])


def _figure(width: float, height: float, gap: float = 0.04) -> Figure:
    figure = Figure(figsize=(width, height), dpi=110, layout=ConstrainedLayoutEngine(h_pad=gap))
    FigureCanvasAgg(figure)
    return figure


def _grid(axes: Axes) -> None:
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)


def _save(figure: Figure, target: io.BytesIO) -> None:
    figure.savefig(target, format="png", metadata={"Software": None})
