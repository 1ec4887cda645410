"""Plots of a calibration: residuals in the image and with the expected noise, coverage, geometry."""

import io
import textwrap
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure, FigureBase
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from im_calibration.judgement.calibration import Calibration
from im_calibration.problem.problem import CalibrationProblem
from im_calibration.targets.views import ShownViews
from im_cell.calibration_error import CalibrationError
from im_cell.camera_model import CameraModel

Array = NDArray[np.float64]

USED, REJECTED, NOISE, GRID = "#1f6fb4", "#d1495b", "#8aa6bf", "#dfe5ea"

_COLOURS = ("#e07b39", "#4c956c", "#7b5ea7", "#b08900", "#3a7ca5")
_FRUSTUM_DEPTH = 0.45
_WRIST_LENGTH = 0.10
_SIGMAS_95 = float(np.sqrt(5.991))
_ARROW_SHARE, _NAMED = 0.05, 10


def plot_residuals(calibration: Calibration, problem: CalibrationProblem, target: io.BytesIO) -> None:
    """Plot residuals of each camera as arrows in the image and with the noise, poses left out, and chi-square."""
    count = len(calibration.cameras)
    figure = _figure(4.2 * (count + 1), 8.2)
    _keep_room(figure, wspace=0.25, hspace=0.3)
    for c, camera in enumerate(calibration.cameras):
        _draw_arrows(figure.add_subplot(2, count + 1, c + 1), calibration, problem, c)
        axes = figure.add_subplot(2, count + 1, count + 2 + c)
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
        _title(axes, f"{camera.spots_used} spots, {camera.rms_px:.3f} px RMS{note}\nellipses: 95 % of the noise")
        _grid(axes)
    _list_left_out(figure.add_subplot(2, count + 1, count + 1), calibration)
    _plot_chi2(figure.add_subplot(2, count + 1, 2 * count + 2), calibration)
    _headline(figure, calibration)
    _save(figure, target)


def plot_overlay(calibration: Calibration, problem: CalibrationProblem, shown: ShownViews, target: io.BytesIO) -> None:
    """Plot a view of the target by each camera: with the points found and predicted, and without the lens.

    Args:
        calibration: The result.
        problem: What it was made from.
        shown: Name and image of a view, by camera.
        target: Where the PNG goes.
    """
    cameras = [(c, camera) for c, camera in enumerate(calibration.cameras) if camera.name in shown]
    figure = _figure(11.0, 4.2 * len(cameras) + 0.6)
    _keep_room(figure, wspace=0.12, hspace=0.3)
    for row, (c, camera) in enumerate(cameras):
        (view, image), model = shown[camera.name], camera.model
        of_view = np.array([name.startswith(f"{view} point ") for name in problem.pose_names]) & problem.detected[c]
        found = problem.spots[c][of_view]
        axes = figure.add_subplot(len(cameras), 2, 2 * row + 1)
        axes.imshow(image, cmap="gray")
        axes.plot(*found.T, "+", color=USED, markersize=7, label="found")
        predicted = found - calibration.residuals[c][of_view]
        axes.plot(
            *predicted.T, "o", color=REJECTED, markersize=7, fillstyle="none", markeredgewidth=0.8, label="predicted"
        )
        axes.legend(fontsize=8, loc="upper right")
        _title(axes, f"{camera.name}: view {view}, {len(found)} points")
        grid = np.stack(np.meshgrid(np.arange(model.width), np.arange(model.height)), axis=-1)
        seen = model.through_lens((grid - model.K[:2, 2]) @ np.linalg.inv(model.K[:2, :2]).T)
        axes = figure.add_subplot(len(cameras), 2, 2 * row + 2)
        axes.imshow(map_coordinates(image, (seen[..., 1], seen[..., 0]), order=1), cmap="gray")
        _title(axes, "without the lens: straight edges are straight")
    _headline(figure, calibration)
    _save(figure, target)


def _draw_arrows(axes: Axes, calibration: Calibration, problem: CalibrationProblem, c: int) -> None:
    """Draw the residuals of a camera, magnified, at the spots of the image, and the pattern found."""
    spots, residuals, used = problem.spots[c], calibration.residuals[c], calibration.used[c]
    width, height = problem.image_sizes[c]
    lengths = np.linalg.norm(residuals[used], axis=1)
    scale = float(f"{_ARROW_SHARE * width / max(float(np.median(lengths)) if len(lengths) else 1.0, 1e-9):.1g}")
    axes.quiver(*spots[used].T, *residuals[used].T, angles="xy", scale_units="xy", scale=1.0 / scale, color=USED)
    left_out = np.flatnonzero(_left_out(calibration, problem, c))
    axes.plot(*spots[left_out].T, "x", color=REJECTED, markersize=6)
    for i in left_out[:_NAMED]:
        axes.annotate(problem.pose_names[i], spots[i], (4, 4), textcoords="offset points", fontsize=7, color=REJECTED)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    neighbours = calibration.neighbours
    pattern = neighbours.clause or "no pattern: neighbouring spots are off as noise is"
    if np.isnan(neighbours.correlation):
        pattern = "too few spots to look for a pattern"
    name = f"{calibration.cameras[c].name}: measured less predicted, {scale:,.0f} times as long"
    _title(axes, "\n".join(textwrap.wrap(name, 52) + textwrap.wrap(pattern, 52)))
    _grid(axes)


def _list_left_out(axes: Axes, calibration: Calibration) -> None:
    """List the first rejected poses with the reasons."""
    axes.set_axis_off()
    found = calibration.rejections
    lines = [line for each in found[:_NAMED] for line in textwrap.wrap(f"{each.pose}: {each.reason}", 58)]
    more = [f"and {len(found) - _NAMED} more, see summary.txt"] if len(found) > _NAMED else []
    axes.text(0.0, 1.0, "\n".join(lines + more), va="top", fontsize=7.5, transform=axes.transAxes)
    _title(axes, "Left out, and why" if found else "Nothing was left out")


def _headline(figure: Figure, calibration: Calibration) -> None:
    """Say the outcome at the top of a figure."""
    width = int(11.5 * figure.get_figwidth())
    figure.suptitle("\n".join(textwrap.wrap(calibration.outcome, width, max_lines=2, placeholder=" ...")), fontsize=10)


def plot_coverage(calibration: Calibration, problem: CalibrationProblem, target: io.BytesIO) -> None:
    """Where the spots lie in the images, and where the LED was in the workspace."""
    count = len(calibration.cameras)
    columns = max(count, 2)
    figure = _figure(4.6 * columns, 6.7)
    _keep_room(figure, wspace=0.16, hspace=0.3)
    grid = figure.add_gridspec(2, columns, height_ratios=(1.35, 1.0))
    for c, camera in enumerate(calibration.cameras):
        axes = figure.add_subplot(grid[0, c])
        width, height = problem.image_sizes[c]
        axes.plot(*problem.spots[c][calibration.used[c]].T, "o", color=USED, markersize=4, label="used")
        left_out = problem.spots[c][_left_out(calibration, problem, c)]
        axes.plot(*left_out.T, "x", color=REJECTED, markersize=6, label="rejected")
        image = calibration.images[c]
        levels = np.unique(np.array([1.5, 3.0, 10.0, 30.0, 100.0]) * image.at_spots_px)
        if len(levels) == 5:
            lines = axes.contour(image.u, image.v, image.expected_px, levels=levels, colors=NOISE, linewidths=0.8)
            axes.clabel(lines, fmt="%.2g px", fontsize=7)
        if image.told:
            left, right, top, bottom = np.nan_to_num(image.region)
            for corner, sides in (
                ((-0.5, -0.5), (left, height)),
                ((right, -0.5), (width - right, height)),
                ((left, -0.5), (right - left, top)),
                ((left, bottom), (right - left, height - bottom)),
            ):
                axes.add_patch(Rectangle(corner, *sides, facecolor=REJECTED, alpha=0.12, linewidth=0.0))
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="u [px]", ylabel="v [px]")
        rim = "\nshaded: the rim, where the camera is known far less well" if image.told else ""
        _title(axes, f"{camera.name}: {camera.spots_used} spots in the image, and errors to expect{rim}")
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
        _title(axes, f"LED positions {seen_from}, and the workspace (frame)")
        _grid(axes)
    _headline(figure, calibration)
    _save(figure, target)


def plot_geometry(calibration: Calibration, problem: CalibrationProblem, target: io.BytesIO) -> None:
    """Cameras, LED positions and wrist directions in space, and maps of the errors to expect."""
    figure = _figure(15.0, 7.0)
    grid = figure.add_gridspec(1, 2, left=0.0, right=1.0, bottom=0.0, top=1.0, wspace=0.0, width_ratios=(1.0, 1.35))
    scene, maps = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    scene.subplots_adjust(left=0.0, right=1.0, bottom=0.02, top=0.9)
    draw_scene(scene.add_subplot(projection="3d"), calibration, problem)
    draw_expected(maps, calibration.expected)
    _headline(figure, calibration)
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
    _title(axes, f"{figures}\n{calibration.points_used} poses")
    axes.legend(fontsize=8, loc="lower right")
    _grid(axes)


def _left_out(calibration: Calibration, problem: CalibrationProblem, c: int) -> NDArray[np.bool_]:
    return np.asarray(problem.detected[c] & ~calibration.used[c])


def _figure(width: float, height: float) -> Figure:
    """An empty figure, ``width`` x ``height`` [inch]."""
    figure = Figure(figsize=(width, height), dpi=110)
    FigureCanvasAgg(figure)
    return figure


def _keep_room(figure: Figure, wspace: float, hspace: float = 0.0) -> None:
    """Reserve room for titles and labels; faster than a layout engine, which measures and draws everything twice.

    Args:
        figure: All of it holds axes.
        wspace: Room between two columns, in widths of one.
        hspace: Room between two rows, in heights of one.
    """
    width, height = figure.get_size_inches()
    figure.subplots_adjust(
        left=0.7 / width, right=1.0 - 0.1 / width, bottom=0.5 / height, top=1.0 - 0.85 / height, wspace=wspace,
        hspace=hspace,
    )  # fmt: skip


def _title(axes: Axes, text: str) -> None:
    """Write a title above axes at a fixed height: a search for the height would measure all ticks and labels."""
    axes.set_title(text, fontsize=9, y=1.0)


def _grid(axes: Axes) -> None:
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)


def _save(figure: Figure, target: io.BytesIO) -> None:
    figure.savefig(target, format="png", metadata={"Software": None}, pil_kwargs={"compress_level": 3})


def draw_expected(figure: FigureBase, expected: CalibrationError) -> None:
    """Draw both errors from above and from the side, each RMS over the viewing axis.

    Args:
        figure: An empty figure, or part of one.
        expected: The map; an error that is nowhere defined (triangulation by one camera) is left out.
    """
    errors = (
        ("Triangulation", expected.triangulation_mm, expected.triangulation_rms_mm, "mm"),
        ("Reprojection", expected.reprojection_px, expected.reprojection_rms_px, "px"),
    )
    figure.subplots_adjust(left=0.08, right=0.94, bottom=0.08, top=0.88, wspace=0.35, hspace=0.3)
    known = [error for error in errors if not np.isnan(error[2])]
    for column, (name, values, whole, unit) in enumerate(known):
        for row, third in enumerate((2, 1)):
            axes = figure.add_subplot(2, len(known), row * len(known) + column + 1)
            _draw_map(figure, axes, expected.points, values, third, unit)
            seen_from = "from above" if third == 2 else "from the side"
            _title(axes, f"{name}, {seen_from}" + f"; {whole:.3g} {unit} RMS" * (row == 0))


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
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=8)


def draw_scene(axes: Axes3D, calibration: Calibration, problem: CalibrationProblem) -> None:
    """Draw cameras as frusta, LED positions with the wrist's z axis, and the workspace."""
    used = calibration.used.any(axis=0)
    points = calibration.led_positions
    axes.scatter(*points[used].T, s=12, color="#1f6fb4", depthshade=False, label="pose used")
    if not used.all():
        axes.scatter(*points[~used].T, s=26, color="#d1495b", marker="x", label="pose rejected")
    tips = points + _WRIST_LENGTH * problem.wrist_rotations[:, :, 2]
    axes.add_collection3d(Line3DCollection(np.stack((points, tips), axis=1), colors="#8aa6bf", linewidths=0.8))
    axes.add_collection3d(Line3DCollection(_box(problem), colors="#9aa5ad", linewidths=0.9, linestyles="dashed"))
    for camera, colour in zip(calibration.cameras, _COLOURS * len(calibration.cameras), strict=False):
        axes.add_collection3d(Line3DCollection(_frustum(camera.model), colors=colour, linewidths=1.4))
        axes.scatter(*camera.model.position, s=20, color=colour, depthshade=False, label=camera.name)
    stands = [camera.model.position for camera in calibration.cameras]
    everything = np.vstack((points, problem.workspace.low, problem.workspace.high, stands))
    low, high = everything.min(axis=0) - 0.1, everything.max(axis=0) + 0.1
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.84)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.tick_params(labelsize=7)
    for axis, count in ((axes.xaxis, 5), (axes.yaxis, 3), (axes.zaxis, 6)):
        axis.set_major_locator(MaxNLocator(count))
    axes.view_init(elev=18.0, azim=-50.0)
    _title(axes, "Cameras, poses (tick: wrist z axis) and workspace")
    axes.legend(fontsize=7, loc="upper left")


def _frustum(model: CameraModel) -> Array:
    """Lines of a camera's field of view, shape (8, 2, 3) [m]."""
    corners = np.array([(0.0, 0.0), (model.width, 0.0), (model.width, model.height), (0.0, model.height)])
    ideal = np.column_stack(((corners - model.K[:2, 2]) / np.diag(model.K)[:2], np.ones(4)))
    ends = (ideal * _FRUSTUM_DEPTH - model.t_cam_base) @ model.R_cam_base
    edges = [(model.position, end) for end in ends]
    rim = [(ends[i], ends[(i + 1) % 4]) for i in range(4)]
    return np.array(edges + rim)


def _box(problem: CalibrationProblem) -> Array:
    """The twelve edges of the workspace, shape (12, 2, 3) [m]."""
    low, high = np.array(problem.workspace.low), np.array(problem.workspace.high)
    corners = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    edges = [(a, b) for a, b in combinations(corners, 2) if np.abs(a - b).sum() == 1]
    return np.array([(low + a * (high - low), low + b * (high - low)) for a, b in edges])
