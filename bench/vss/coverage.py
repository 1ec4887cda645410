"""How often the truth is in the 95 % regions that VSS states, over the whole chain: calibrate cameras, then measure.

Each seed draws true cameras, calibrates them from noisy poses and spots, and measures with what was found: a light by
two cameras, a plate and an edge by one, and the laser scanner from the lights of its beams. Each such region counts
once a seed, so that the counts are binomial.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from bench.calibration.synthetic import Design, SyntheticScene, make_scene
from bench.figures import Line
from im_calibration import Calibration, calibrate
from im_cell.camera_model import CameraModel
from im_cell.laser_model import LaserModel
from im_cell.robot import LaserScanner, load_cell
from im_vss.edges.lines import edge_covariance
from im_vss.edges.step import StepFit, StraightEdge
from im_vss.fiducial import Corners, plate_poses, with_calibration
from im_vss.laser.calibration import CalibrationGates, LaserSpot
from im_vss.laser.calibration import calibrate as calibrate_laser
from im_vss.settings import load_settings
from im_vss.stereo import Point, triangulate

Array = NDArray[np.float64]

SEEDS = 200
LEAST, MOST = 0.92, 0.97
_SHARE = 0.95
_SPOT_PX = 0.03
_CORNER_PX = 0.03
_PLATE_M = 0.24
_EDGE_PX = 120.0
_HEIGHTS_M = (0.2, 0.5, 0.8, 1.2)
_BEAMS = 36
_REACH_RAD = 0.15


@dataclass(frozen=True)
class Measured:
    """Cameras that were calibrated, and true ones.

    Attributes:
        scene: The truth.
        calibration: What was found.
        rng: Draws of what comes next.
    """

    scene: SyntheticScene
    calibration: Calibration
    rng: np.random.Generator

    @property
    def models(self) -> tuple[CameraModel, ...]:
        """The cameras as found."""
        return tuple(camera.model for camera in self.calibration.cameras)

    def known(self, *cameras: str) -> Array:
        """Covariance of the parameters of cameras; without names, of all."""
        names = cameras or tuple(camera.name for camera in self.calibration.cameras)
        return self.calibration.camera_covariance.of(names)

    def look(self, place: Array) -> Point:
        """Where the cameras see a light that is at a place, shape (3,) [m]."""
        spots = [true.project(place) + self.rng.normal(0.0, _SPOT_PX, 2) for true in self.scene.cameras]
        return triangulate(self.models, spots, [_SPOT_PX**2 * np.eye(2)] * len(spots), self.known())


def calibrated(seed: int, design: Design) -> Measured:
    """Cameras calibrated from the observations of a seed."""
    scene = make_scene(design, seed)
    return Measured(scene, calibrate(scene.problem), np.random.default_rng((seed, 2)))


def stereo(cameras: Measured) -> tuple[float, int]:
    """Squared distance of a light from its place, in its covariance, and the degrees of freedom of that."""
    box = cameras.scene.problem.workspace
    place = cameras.rng.uniform(box.low, box.high)
    point = cameras.look(place)
    return _squared(point.position - place, point.covariance), 3


def fiducial(cameras: Measured) -> tuple[float, int]:
    """The same of a plate, seen by the first camera, in its optical frame."""
    rng, true, found = cameras.rng, cameras.scene.cameras[0], cameras.models[0]
    turn = Rotation.from_euler("xyz", [np.pi + rng.normal(0.0, 0.3), rng.normal(0.0, 0.3), rng.uniform(-3.0, 3.0)])
    rotation, depth = turn.as_matrix(), rng.uniform(1.2, 2.5)
    place = np.append(rng.uniform(-0.3, 0.3, 2) * depth, depth)
    half = _PLATE_M / 2.0
    points = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]]) @ rotation.T
    pixels = replace(true, R_cam_base=np.eye(3), t_cam_base=np.zeros(3)).project(points + place)
    corners = undistorted(found, pixels + rng.normal(0.0, _CORNER_PX, (4, 2)), _CORNER_PX)
    best = plate_poses(corners, found.K, _PLATE_M)[0]
    pose = with_calibration(best, corners, found, _PLATE_M, cameras.known(cameras.calibration.cameras[0].name))
    off = Rotation.from_matrix(pose.rotation @ rotation.T).as_rotvec()
    return _squared(np.append(pose.translation - place, off), pose.covariance), 6


def line(cameras: Measured) -> tuple[float, int]:
    """The same of offset and angle of a straight edge in the first camera, by the places of its ends in the image."""
    rng, true, found = cameras.rng, cameras.scene.cameras[0], cameras.models[0]
    middle, turn = rng.uniform((200.0, 140.0), (440.0, 340.0)), rng.uniform(-np.pi, np.pi)
    way = _EDGE_PX / 2.0 * np.array([np.cos(turn), np.sin(turn)])
    ideal = true.undistort(np.stack((middle - way, middle + way)))
    pixels = true.through_lens(ideal) + rng.normal(0.0, _CORNER_PX, (2, 2))
    start, end = found.to_pixels(found.undistort(pixels))
    length = float(np.linalg.norm(end - start))
    noise = _CORNER_PX**2 * np.diag([0.5, 2.0 / length**2])
    fit = StepFit(np.zeros(2), noise, contrast=1.0, sigma=1.0, chi2_per_dof=1.0, contrast_snr=1.0)
    edge = StraightEdge((start + end) / 2.0, (end - start) / length, length, fit, 2)
    first, second = (found.to_pixels(ideal) - (start, end)) @ edge.normal
    covariance = edge_covariance(edge, found, cameras.known(cameras.calibration.cameras[0].name))
    return _squared(np.array([0.5 * (first + second), (second - first) / length]), covariance), 2


def laser(cameras: Measured) -> tuple[float, int]:
    """The same of all that is calibrated of the laser scanner."""
    (sheet, gates), rng = _scanner(), cameras.rng
    limits, (rotation, position) = sheet.tolerance, sheet.pose()
    first, second, offset, gap = rng.normal(
        [1.0, 1.0, 0.0, sheet.gap], [limits.gain, limits.gain, limits.offset, limits.gap]
    )
    turn = Rotation.from_rotvec(rng.uniform(-0.03, 0.03, 3)).as_matrix()
    true = LaserModel(turn @ rotation, position + rng.uniform(-0.03, 0.03, 3), gap, (first, second), offset)
    spots = []
    for number in range(_BEAMS):
        angles = rng.uniform(-_REACH_RAD, _REACH_RAD, 2)
        start, way = true.rays(angles + rng.normal(0.0, sheet.repeatability, 2))
        place = start + (_HEIGHTS_M[number % len(_HEIGHTS_M)] - start[2]) / way[2] * way
        if all(camera.contains(camera.project(place), 5.0) for camera in cameras.scene.cameras):
            spots.append(LaserSpot(angles, cameras.look(place)))
    found = calibrate_laser(sheet, spots, cameras.known(), gates)
    model = found.model
    error = np.concatenate(
        (
            Rotation.from_matrix(model.rotation @ true.rotation.T).as_rotvec(),
            model.position - true.position,
            np.subtract(model.gain, true.gain),
            [model.offset - true.offset, model.gap - true.gap],
        )
    )
    return _squared(error, found.covariance), len(error)


MEASUREMENTS: dict[str, Callable[[Measured], tuple[float, int]]] = {
    "stereo": stereo,
    "fiducial": fiducial,
    "line": line,
    "laser": laser,
}


def undistorted(camera: CameraModel, pixels: Array, sigma: float) -> Corners:
    """Corners where they are without the lens, of pixels, shape (4, 2), each with a standard deviation [px]."""
    ideal, pinhole = camera.undistort(pixels), camera.K[:2, :2]
    spread = np.zeros((8, 8))
    for corner, point in enumerate(ideal):
        taken_out = pinhole @ np.linalg.inv(pinhole @ camera.lens.jacobian(point, camera.D))
        spread[2 * corner : 2 * corner + 2, 2 * corner : 2 * corner + 2] = sigma**2 * taken_out @ taken_out.T
    return Corners(ideal @ pinhole.T + camera.K[:2, 2], spread)


def lines(seeds: int = SEEDS, design: Design | None = None) -> list[Line]:
    """Shares of the seeds in which the truth is in the region, with their bars; of those that VSS would use."""
    inside, used = dict.fromkeys(MEASUREMENTS, 0), 0
    for seed in range(seeds):
        cameras = calibrated(seed, design or Design())
        if not cameras.calibration.success:
            continue
        used += 1
        for name, measure in MEASUREMENTS.items():
            distance, freedom = measure(cameras)
            inside[name] += distance < chi2.ppf(_SHARE, freedom)
    found = [Line("calibrations without a verdict", used / seeds, "")]
    for name, count in inside.items() if used else ():
        found.append(Line(f"truth in the 95 % region: {name}", count / used, "", bar=LEAST, at_least=True))
        found.append(Line(f"    and not too often: {name}", count / used, "", bar=MOST))
    return found


@cache
def _scanner() -> tuple[LaserScanner, CalibrationGates]:
    """The scanner as drawn, and when its calibration is good enough."""
    cell = load_cell()
    return cell.scanner, load_settings(cell).laser.calibration


def _squared(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error))
