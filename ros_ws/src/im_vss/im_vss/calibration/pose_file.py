"""Files of wrist poses, as ``scripts/run.sh im_mcs poses`` writes them, as candidates for the next observation."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator
from scipy.spatial.transform import Rotation

from im_core.config import Model, load_model
from im_core.errors import DataError
from im_vss.calibration.next_pose import Candidates
from im_vss.calibration.problem import CalibrationProblem

_UNIT = 1e-3


class CandidatePose(Model):
    """A wrist pose.

    Attributes:
        name: Its name.
        position_m: Origin of the wrist in the base frame [m].
        orientation_xyzw: Unit quaternion wrist -> base.
        J_joint: Derivatives of the LED position by the joints, three rows [m/rad]; needed with joint offsets only.
    """

    name: str
    position_m: tuple[float, float, float]
    orientation_xyzw: tuple[float, float, float, float]
    J_joint: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] | None = None

    @field_validator("orientation_xyzw")
    @classmethod
    def _is_unit(cls, value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        if abs(float(np.linalg.norm(value)) - 1.0) > _UNIT:
            raise ValueError(f"must be a unit quaternion, its length is {np.linalg.norm(value):g}")
        return value


class PoseFile(Model):
    """A file of wrist poses.

    Attributes:
        group: Group of joints that reaches them.
        frame: Frame of the poses; the base of the data set.
        poses: The poses.
    """

    group: str = ""
    frame: Literal["world", "base"]
    poses: Annotated[tuple[CandidatePose, ...], Field(min_length=1)]


def load_candidates(path: Path, problem: CalibrationProblem) -> Candidates:
    """Poses of a file, to be measured like those of a problem: with its mean position noise and typical spot noise.

    Args:
        path: The file (YAML).
        problem: What is known so far; its nominal LED offset makes LED positions of wrist poses.

    Raises:
        ConfigError: The file cannot be read, or breaks the format; file, line and field are named.
        DataError: The problem has joint offsets, and a pose does not say what they do.
    """
    poses = load_model(path, PoseFile).poses
    rotations = Rotation.from_quat([pose.orientation_xyzw for pose in poses]).as_matrix()
    positions = np.array([pose.position_m for pose in poses]) + rotations @ np.array(problem.led_offset_nominal)
    jacobians = None
    if problem.joint_jacobians is not None:
        joints = problem.joint_jacobians.shape[2]
        for pose in poses:
            if pose.J_joint is None or any(len(row) != joints for row in pose.J_joint):
                raise DataError(f"{path}: pose {pose.name} needs J_joint, 3 rows of {joints}, for the joint offsets.")
        jacobians = np.array([pose.J_joint for pose in poses])
    noise = np.array([
        np.median(covariances[seen], axis=0) if seen.any() else np.eye(2)
        for covariances, seen in zip(problem.spot_covariances, problem.detected, strict=True)
    ])  # fmt: skip
    return Candidates(
        names=tuple(pose.name for pose in poses),
        positions=positions,
        position_covariances=np.tile(problem.position_covariances.mean(axis=0), (len(poses), 1, 1)),
        wrist_rotations=rotations,
        spot_covariances=np.tile(noise[:, None], (1, len(poses), 1, 1)),
        joint_jacobians=jacobians,
    )
