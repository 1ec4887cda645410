"""A request of each vision Service, as benchmarks send them; all can be answered."""

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from im_core.camera_model import CameraModel
from im_core.robot.truth import CellTruth
from im_msgs.msg import Observation, Spot
from im_msgs.srv import (
    Calibrate,
    CircleFind,
    FiducialPose,
    LaserCalibrate,
    LaserPoint,
    LaserSpot3d,
    LineFind,
    LineScan,
    Snap,
    SpotFind,
    SpotFindStereo,
)

CEILING = ["ceiling_left", "ceiling_right"]
LIGHT = "left_led"
ON_TABLE = (0.1, 1.1, 0.75)
LINES = 5
_POSES = 40
_LOW, _HIGH = np.array([-0.7, -0.5, 0.6]), np.array([0.7, 0.7, 1.7])
_SPOT_SD_PX, _ARM_SD_M = 0.04, 2e-4

Requests = dict[str, tuple[type, Callable[[int], Any]]]


def requests(truth: CellTruth) -> Requests:
    """By name of each Service its type and what makes its n-th request.

    Args:
        truth: Of the testbed, which observations for `calibrate` are drawn from.
    """
    seen = observations(truth)
    angles = truth.laser.model().angles_to(np.array(ON_TABLE))

    def at(number: int) -> list[float]:
        """Mirror angles, other than those before."""
        return [float(angle) + 0.002 * (number % 9) for angle in angles]

    span = [float(angles[0]) - 0.03, float(angles[0]) + 0.03]
    sweep = [float(angles[1]) - 0.03, float(angles[1]) + 0.03]
    return {
        "snap": (Snap, lambda _: Snap.Request(cameras=CEILING)),
        "spot_find": (SpotFind, lambda _: SpotFind.Request(cameras=CEILING)),
        "spot_find_stereo": (SpotFindStereo, lambda _: SpotFindStereo.Request(cameras=CEILING)),
        "circle_find": (CircleFind, lambda _: CircleFind.Request(camera=CEILING[0])),
        "line_find": (LineFind, lambda _: LineFind.Request(camera=CEILING[0])),
        "fiducial_pose": (FiducialPose, lambda _: FiducialPose.Request(cameras=CEILING)),
        "calibrate": (Calibrate, lambda _: Calibrate.Request(cameras=CEILING, observations=seen)),
        "laser_point": (LaserPoint, lambda n: LaserPoint.Request(angles=at(n), on=False)),
        "laser_spot_3d": (LaserSpot3d, lambda n: LaserSpot3d.Request(cameras=CEILING, angles=at(n))),
        "line_scan": (LineScan, lambda _: LineScan.Request(cameras=CEILING, span=span, sweep=sweep, lines=LINES)),
        "laser_calibrate": (LaserCalibrate, lambda _: LaserCalibrate.Request(cameras=CEILING)),
    }


def observations(truth: CellTruth) -> list[Observation]:
    """What the ceiling cameras see of the wrist light at random poses, with the noise of a good measurement."""
    rng = np.random.default_rng(truth.seed)
    cameras = {name: _model(truth, name) for name in CEILING}
    found = []
    for number in range(_POSES):
        light = rng.uniform(_LOW, _HIGH)
        rotation = Rotation.random(random_state=rng)
        wrist = light - rotation.apply(truth.leds[LIGHT].offset_m) + rng.normal(0.0, _ARM_SD_M, 3)
        seen = {name: camera.project(light) + rng.normal(0.0, _SPOT_SD_PX, 2) for name, camera in cameras.items()}
        x, y, z, w = (float(value) for value in rotation.as_quat())
        found.append(
            Observation(
                pose=f"pose_{number}",
                wrist=Pose(position=Point(**dict(zip("xyz", map(float, wrist), strict=True))),
                           orientation=Quaternion(x=x, y=y, z=z, w=w)),
                position_covariance=(_ARM_SD_M**2 * np.eye(3)).ravel(),
                spots=[_spot(name, uv) for name, uv in seen.items()],
            )
        )  # fmt: skip
    return found


def _model(truth: CellTruth, name: str) -> CameraModel:
    true = truth.cameras[name]
    return CameraModel(
        true.width, true.height, np.array(true.K), np.array(true.D), np.array(true.R_cam_base),
        np.array(true.t_cam_base_m),
    )  # fmt: skip


def _spot(camera: str, uv: NDArray[np.float64]) -> Spot:
    covariance = (_SPOT_SD_PX**2 * np.eye(2)).ravel()
    return Spot(camera=camera, found=True, u=float(uv[0]), v=float(uv[1]), covariance=covariance)
