"""Seeded synthetic problems with lenses of any length, in any unit of length, and their truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.calibration.synthetic import SyntheticScene, random_rotations
from im_calibration.problem.problem import CalibrationProblem
from im_cell.camera_model import CameraModel
from im_cell.lens import EQUIDISTANT, PLUMB_BOB, RATIONAL_POLYNOMIAL, LensModel
from im_cell.workspace import Workspace

Array = NDArray[np.float64]

_DISTANCE_M = 3.0
_TURN = 0.5  # between neighbouring cameras, about the middle of the workspace [rad]


@dataclass(frozen=True)
class LensKind:
    """A kind of lens: what each coefficient does to the corner of the image, relative to its distance from the middle.

    Attributes:
        model: Its lens model.
        mean: Mean effects.
        spread: Standard deviations of the effects.
    """

    model: LensModel
    mean: tuple[float, ...]
    spread: tuple[float, ...]


KINDS = {
    "mild": LensKind(PLUMB_BOB, (-0.02, 0.0, 0.0, 0.0, 0.0), (0.02, 0.01, 0.001, 0.001, 0.0)),
    "barrel": LensKind(PLUMB_BOB, (-0.12, 0.02, 0.0, 0.0, 0.0), (0.02, 0.01, 0.001, 0.001, 0.0)),
    "k3": LensKind(PLUMB_BOB, (-0.15, 0.06, 0.0, 0.0, 0.05), (0.02, 0.02, 0.001, 0.001, 0.01)),
    "rational": LensKind(
        RATIONAL_POLYNOMIAL, (0.2, 0.02, 0.0, 0.0, 0.0, 0.45, 0.15, 0.03),
        (0.02, 0.01, 0.001, 0.001, 0.0, 0.03, 0.02, 0.01),
    ),
    "fisheye": LensKind(EQUIDISTANT, (-0.02, 0.01, 0.0, 0.0), (0.02, 0.01, 0.003, 0.001)),
}  # fmt: skip
"""Lenses by name: what is usual, a strong k3, wide ones."""


@dataclass(frozen=True)
class LensDesign:
    """What to simulate: cameras around a workspace that fills their images.

    Attributes:
        view_deg: Angle of view over the width of the image [deg].
        poses: Number of poses.
        cameras: Number of cameras.
        sigma_px: Standard deviation of each spot coordinate [px].
        sigma_m: Standard deviation of each coordinate of the LED position by the robot [m].
        metre: Length of a metre in the unit of the data set: 1000 for millimetres.
        depth_m: Half the depth of the workspace [m]; 0: as deep as it is wide.
        image_size: Width and height [px].
        lens: Kind of lens, see :data:`KINDS`.
        fitted: Name of the lens model that is calibrated.
    """

    view_deg: float
    poses: int = 40
    cameras: int = 2
    sigma_px: float = 0.1
    sigma_m: float = 2e-4
    metre: float = 1.0
    depth_m: float = 0.0
    image_size: tuple[int, int] = (1280, 1024)
    lens: str = "mild"
    fitted: str = PLUMB_BOB.name


def make_lens_scene(design: LensDesign, seed: int) -> SyntheticScene:
    """Simulate the observations of a design."""
    rng = np.random.default_rng(seed)
    width, height = design.image_size
    half = _DISTANCE_M * np.tan(np.deg2rad(design.view_deg) / 2.0)
    box = design.metre * np.array([0.9 * half, 0.9 * half * height / width, design.depth_m or half])
    truth = rng.uniform(-box, box, (design.poses, 3))
    cameras = tuple(_draw_camera(rng, design, i) for i in range(design.cameras))
    c, n, sigma = design.cameras, design.poses, design.sigma_m * design.metre
    spots = np.stack([camera.project(truth) for camera in cameras]) + rng.normal(0.0, design.sigma_px, (c, n, 2))
    inside = np.stack([camera.contains(spot) for camera, spot in zip(cameras, spots, strict=True)])
    spots[~inside] = np.nan
    x, y, z = (float(side) for side in box)
    problem = CalibrationProblem(
        camera_names=tuple(f"camera_{i}" for i in range(c)),
        image_sizes=(design.image_size,) * c,
        positions=truth + rng.normal(0.0, sigma, truth.shape),
        position_covariances=np.tile(sigma**2 * np.eye(3), (n, 1, 1)),
        wrist_rotations=random_rotations(rng, n),
        spots=spots,
        spot_covariances=np.tile(design.sigma_px**2 * np.eye(2), (c, n, 1, 1)),
        workspace=Workspace((-x, -y, -z), (x, y, z)),
        lens_models=(design.fitted,) * c,
    )
    return SyntheticScene(problem, cameras, np.zeros(3), np.zeros(6), np.zeros((c, n), dtype=bool))


def _draw_camera(rng: np.random.Generator, design: LensDesign, index: int) -> CameraModel:
    """A camera that looks at the middle, its lens moving the corner of the image by some percent."""
    width, height = design.image_size
    turn = _TURN * (index - (design.cameras - 1) / 2.0)
    centre = _DISTANCE_M * np.array([np.sin(turn), 0.1 * index, np.cos(turn)])
    z = -centre / np.linalg.norm(centre)
    x = np.cross([0.0, 1.0, 0.0], z) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], z))
    rotation = np.stack((x, np.cross(z, x), z))
    focal = width / 2.0 / np.tan(np.deg2rad(design.view_deg) / 2.0)
    corner = float(np.hypot(width, height)) / 2.0 / focal
    fx, fy = focal * (1.0 + rng.normal(0.0, 0.01, 2))
    cx, cy = np.array([width, height]) / 2.0 - 0.5 + rng.normal(0.0, 10.0, 2)
    kind = KINDS[design.lens]
    if kind.model is EQUIDISTANT:
        fx, fy = (f * np.tan(np.deg2rad(design.view_deg) / 2.0) / np.deg2rad(design.view_deg / 2.0) for f in (fx, fy))
        corner = float(np.hypot(width, height)) / 2.0 / fx
    D = rng.normal(kind.mean, kind.spread) / corner ** np.array(kind.model.powers)
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return CameraModel(width, height, K, D, rotation, -design.metre * rotation @ centre, kind.model.name)
