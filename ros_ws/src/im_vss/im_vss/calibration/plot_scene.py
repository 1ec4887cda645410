"""The cameras, the poses and the workspace in three dimensions."""

from itertools import combinations

import numpy as np
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from numpy.typing import NDArray

from im_core.camera_model import CameraModel
from im_vss.calibration.calibration import Calibration
from im_vss.calibration.problem import CalibrationProblem

Array = NDArray[np.float64]

_COLOURS = ("#e07b39", "#4c956c", "#7b5ea7", "#b08900", "#3a7ca5")
_FRUSTUM_DEPTH = 0.45
_WRIST_LENGTH = 0.10


def draw_scene(axes: Axes3D, calibration: Calibration, problem: CalibrationProblem) -> None:
    """Draw cameras as frusta, LED positions with the wrist's z axis, and the workspace.

    Args:
        axes: Three-dimensional axes.
        calibration: The result.
        problem: What it was made from.
    """
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
    axes.set_box_aspect(high - low, zoom=0.88)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.tick_params(labelsize=7)
    for axis, count in ((axes.xaxis, 5), (axes.yaxis, 3), (axes.zaxis, 6)):
        axis.set_major_locator(MaxNLocator(count))
    axes.view_init(elev=18.0, azim=-50.0)
    axes.set_title("Cameras, poses (tick: wrist z axis) and workspace", fontsize=9)
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
