"""Which further pose would improve a calibration most, and how far: optimal design from the information matrix.

A pose not yet measured has no spots, but it is known where they will be and how the noise will be: its information
``J^T S^-1 J`` adds to what there is. The errors over the workspace are quadratic forms ``trace(W P)`` of the covariance
P, so that a candidate lowers their mean square by ``trace(W P J^T (S + J P J^T)^-1 J P)``. Source: Pukelsheim, "Optimal
Design of Experiments" (1993), chapter 9 (A-optimality with a weight); the update is the matrix inversion lemma.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from im_calibration.estimation.projection import image
from im_calibration.estimation.residuals import linearise
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns, intrinsics_of
from im_calibration.judgement.calibration import Calibration
from im_calibration.judgement.expected import inside, sensitivity
from im_calibration.problem.problem import CalibrationProblem
from im_cell.camera_model import CameraModel
from im_cell.rotations import UNIT_TOLERANCE, matrix_of_quaternion
from im_core.config import Model, load_model
from im_core.errors import DataError

Array = NDArray[np.float64]

#: Before the first spot: standard deviations of a camera's pose as drawn [rad], [m], and of its focal length.
_ANYWHERE_SD, _ANY_FOCAL_SHARE = 0.1, 0.05


@dataclass(frozen=True)
class Candidates:
    """Candidate poses for the next measurement.

    Attributes:
        names: One label a pose.
        positions: LED positions by the robot with the nominal LED offset, shape (m, 3) [m].
        position_covariances: Their covariances, shape (m, 3, 3) [m^2].
        wrist_rotations: Rotations wrist -> base, shape (m, 3, 3).
        spot_covariances: Covariances that spots will have, shape (c, m, 2, 2) [px^2].
        joint_jacobians: Derivatives of the positions by the joints, shape (m, 3, k) [m/rad]; None: no joint offsets.
    """

    names: tuple[str, ...]
    positions: Array
    position_covariances: Array
    wrist_rotations: Array
    spot_covariances: Array
    joint_jacobians: Array | None = None


@dataclass(frozen=True)
class NextPose:
    """Pose to measure, with the expected benefit.

    Attributes:
        index: Its place among the candidates.
        name: Its name.
        cameras: Cameras that will see the LED.
        reprojection_px: Expected RMS reprojection error over the workspace without it and with it [px].
        triangulation_mm: Expected RMS triangulation error without and with it, NaN for one camera [mm].
    """

    index: int
    name: str
    cameras: tuple[str, ...]
    reprojection_px: tuple[float, float]
    triangulation_mm: tuple[float, float]


def next_best_poses(
    calibration: Calibration, problem: CalibrationProblem, candidates: Candidates, count: int = 1
) -> tuple[NextPose, ...]:
    """Return the poses to measure next, best first, each in addition to the earlier ones.

    Best is what lowers the expected triangulation error most; reprojection error where no two cameras see a common part
    of the workspace. No candidate comes twice.

    Raises:
        DataError: There are fewer candidates that a camera sees, or their arrays do not fit the problem.

    >>> two, of_two = np.tile(np.eye(3), (2, 1, 1)), np.tile(1e-2 * np.eye(2), (1, 2, 1, 1))
    >>> corner_or_middle = np.array([[0.9, 0.7, 0.6], [0.0, 0.0, 1.1]])
    >>> candidates = Candidates(("corner", "middle"), corner_or_middle, 1e-8 * two, two, of_two)
    >>> [pose.name for pose in next_best_poses(calibration, problem, candidates)]
    ['corner']
    """
    unknowns = unknowns_of(calibration, len(candidates.names))
    predicted = _predicted(problem, candidates, unknowns)
    layout = ParameterLayout.of(predicted)
    visible = predicted.detected
    if not 1 <= count <= int(visible.any(axis=0).sum()):
        raise DataError(
            f"{count} poses are wanted, {int(visible.any(axis=0).sum())} of {len(candidates.names)} candidates are in "
            "view of a camera."
        )
    line = linearise(unknowns, predicted, layout, visible)
    errors = _Errors(unknowns, problem)
    covariance, chosen = calibration.covariance, list[NextPose]()
    left: NDArray[np.bool_] = np.array(visible.any(axis=0))
    for _ in range(count):
        before = errors(covariance)
        moved = line.jacobians @ covariance
        spread: Array = np.asarray(np.linalg.inv(line.covariances + moved @ np.swapaxes(line.jacobians, 1, 2)))
        best = int(np.argmax(np.where(left, errors.lowered(moved, spread), -np.inf)))
        covariance = covariance - moved[best].T @ spread[best] @ moved[best]
        covariance, left[best] = (covariance + covariance.T) / 2.0, False
        after = errors(covariance)
        cameras = tuple(np.array(problem.camera_names, dtype=object)[visible[:, best]])
        chosen.append(NextPose(best, candidates.names[best], cameras, (before[0], after[0]), (before[1], after[1])))
    return tuple(chosen)


class PoseDesign:
    """Choice of poses by information for the time of a visit: D-optimal design, one pose after the other.

    Args:
        predicted: The poses, as of :func:`predicted_problem`.
        unknowns: The cameras, from a calibration or as drawn, with as many LEDs.
        covariance: Covariance of all unknowns so far, shape (size, size); None: no more is known than of any lens.
        looks: Spots of each camera at a visit.
    """

    def __init__(self, predicted: CalibrationProblem, unknowns: Unknowns, covariance: Array | None, looks: int) -> None:
        layout = ParameterLayout.of(predicted)
        line = linearise(unknowns, predicted, layout, predicted.detected)
        self._jacobians, self._noise, self._looks = line.jacobians, line.covariances, looks
        self._errors = _Errors(unknowns, predicted)
        self._seen = predicted.detected.any(axis=0)
        prior = np.where(layout.prior_precision > 0.0, layout.prior_precision, _ANYWHERE_SD**-2)
        for c in range(layout.cameras):
            focal = slice(layout.camera_slice(c).start, layout.camera_slice(c).start + 2)
            prior[focal] = (_ANY_FOCAL_SHARE * unknowns.intrinsics[c, :2]) ** -2
        self._covariance = np.diag(1.0 / prior) if covariance is None else covariance[: layout.size, : layout.size]

    @property
    def expected_mm(self) -> float:
        """Expected RMS triangulation error over the workspace, NaN for one camera [mm]."""
        return self._errors(self._covariance)[1]

    def add(self, pose: int, looks: int) -> None:
        """Count some looks at a pose as done."""
        moved = self._jacobians[pose] @ self._covariance
        spread = np.linalg.inv(self._noise[pose] / looks + moved @ self._jacobians[pose].T)
        covariance = self._covariance - moved.T @ spread @ moved
        self._covariance = (covariance + covariance.T) / 2.0

    def best(self, seconds: Array, allowed: NDArray[np.bool_]) -> int | None:
        """Return the pose with the most information for the time of a visit; None without an allowed one.

        Args:
            seconds: Time of a visit of each pose, shape (m,) [s].
            allowed: Which poses may be chosen, shape (m,).
        """
        left = allowed & self._seen
        if not left.any():
            return None
        noise = self._noise / self._looks
        spread = noise + self._jacobians @ self._covariance @ np.swapaxes(self._jacobians, 1, 2)
        gain = np.linalg.slogdet(spread)[1] - np.linalg.slogdet(noise)[1]
        return int(np.argmax(np.where(left, gain / seconds, -np.inf)))


def unknowns_of(calibration: Calibration, poses: int) -> Unknowns:
    """Return the estimate as a value of all unknowns, with the LED of any number of poses at the robot's positions."""
    models = [camera.model for camera in calibration.cameras]
    return unknowns_as_drawn(models, poses, calibration.led_offset_error, calibration.joint_offsets)


def unknowns_as_drawn(
    models: Sequence[CameraModel], poses: int, led_offset_error: Array | None = None, joint_offsets: Array | None = None
) -> Unknowns:
    """Return cameras as a value of all unknowns; missing offsets are 0."""
    return Unknowns(
        tuple(m.lens for m in models),
        intrinsics_of(models),
        np.array([m.R_cam_base for m in models]),
        np.array([m.t_cam_base for m in models]),
        np.zeros(3) if led_offset_error is None else led_offset_error,
        np.zeros(0) if joint_offsets is None else joint_offsets,
        np.zeros((poses, 3)),
    )


class _Errors:
    """Expected RMS errors over the workspace as functions of the covariance."""

    def __init__(self, unknowns: Unknowns, problem: CalibrationProblem) -> None:
        gains = sensitivity(unknowns, problem.image_sizes, problem.workspace)
        self._size = sum(one.shape[-1] for one in gains.pixels)
        self._pixels, self._points = gains.reprojection_weight(), gains.triangulation_weight()

    def __call__(self, covariance: Array) -> tuple[float, float]:
        """Reprojection [px] and triangulation [mm]."""
        cameras = covariance[: self._size, : self._size]
        pixels = float(np.sqrt(np.sum(self._pixels * cameras)))
        return pixels, float("nan") if self._points is None else float(np.sqrt(np.sum(self._points * cameras)))

    def lowered(self, moved: Array, spread: Array) -> Array:
        """By how much each candidate lowers the mean square error, shape (m,)."""
        weight = self._pixels if self._points is None else self._points
        cameras = moved[:, :, : self._size]
        return np.asarray(np.einsum("mij,mja,ab,mib->m", spread, cameras, weight, cameras, optimize=True))


def _predicted(problem: CalibrationProblem, candidates: Candidates, unknowns: Unknowns) -> CalibrationProblem:
    """Return the candidates as a problem with spots at the places expected by the calibration, all in the images."""
    m = len(candidates.positions)
    if np.shape(candidates.spot_covariances) != (len(problem.camera_names), m, 2, 2):
        raise DataError(f"Spot covariances of {m} candidates in {len(problem.camera_names)} cameras are needed.")
    predicted = replace(
        problem,
        positions=candidates.positions,
        position_covariances=candidates.position_covariances,
        wrist_rotations=candidates.wrist_rotations,
        spots=np.zeros((len(problem.camera_names), m, 2)),
        spot_covariances=candidates.spot_covariances,
        joint_jacobians=candidates.joint_jacobians,
        arm_jacobians=None,
        pose_names=candidates.names,
        readings=(),
    )
    return predicted_problem(predicted, unknowns)


def predicted_problem(problem: CalibrationProblem, unknowns: Unknowns) -> CalibrationProblem:
    """Return a problem with spots at the places expected of the unknowns, not detected outside of the images."""
    pixels = image(unknowns, unknowns.robot_positions(problem))
    return replace(problem, spots=np.where(inside(pixels, problem.image_sizes)[..., None], pixels, np.nan))


class CandidatePose(Model):
    """A wrist pose.

    Attributes:
        name: Its name.
        position_m: Origin of the wrist in the base frame [m].
        orientation_xyzw: Unit quaternion wrist -> base.
        joints: Positions of the group's joints there [rad or m]; not needed here.
        J_joint: Derivatives of the LED position by the joints, three rows [m/rad]; needed with joint offsets only.
    """

    name: str
    position_m: tuple[float, float, float]
    orientation_xyzw: tuple[float, float, float, float]
    joints: tuple[float, ...] | None = None
    J_joint: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] | None = None

    @field_validator("orientation_xyzw")
    @classmethod
    def _is_unit(cls, value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        if abs(float(np.linalg.norm(value)) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"must be a unit quaternion, its length is {np.linalg.norm(value):g}")
        return value


class PoseFile(Model):
    """A file of wrist poses.

    Attributes:
        group: Group of joints that reaches them.
        frame: Frame of the poses; the base of the data set.
        other_joints: Where the other arm must stand [rad or m]; not needed here.
        order: Whether the poses are visited as listed; not needed here.
        poses: The poses.
    """

    group: str = ""
    frame: Literal["world", "base"]
    other_joints: tuple[float, ...] | None = None
    order: Literal["given", "free"] = "given"
    poses: Annotated[tuple[CandidatePose, ...], Field(min_length=1)]


def load_candidates(path: Path, problem: CalibrationProblem) -> Candidates:
    """Read poses from a file, to be measured with the mean position noise and the typical spot noise of a problem.

    Args:
        path: The file (YAML).
        problem: What is known so far; its nominal LED offset makes LED positions of wrist poses.

    Raises:
        ConfigError: The file cannot be read, or breaks the format; file, line and field are named.
        DataError: The problem has joint offsets, and a pose does not say what they do.
    """
    poses = load_model(path, PoseFile).poses
    rotations = matrix_of_quaternion([pose.orientation_xyzw for pose in poses])
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
