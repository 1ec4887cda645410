"""Result of the command ``calibrate_camera``, as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """Estimate of a camera.

    Attributes:
        name: Name of the camera.
        size: Width and height [px].
        K: Intrinsics, shape (3, 3) [px].
        D: Coefficients of the lens model.
        distortion_model: Lens model, as in ``sensor_msgs/msg/CameraInfo``.
        R_cam_base: Rotation world -> camera, shape (3, 3).
        t_cam_base: Origin of the world in the camera frame, shape (3,) [m].
        rms_px: Residuals [px].
        spots_used: Number of spots.
        covariance: Of the parameters, shape (n, n); NaN where unknown.
    """

    name: str
    size: tuple[int, int]
    K: Array
    D: Array
    distortion_model: str
    R_cam_base: Array
    t_cam_base: Array
    rms_px: float
    spots_used: int
    covariance: Array


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of ``calibrate_camera``.

    Attributes:
        success: Whether there is no verdict against the estimate.
        message: Outcome in a sentence or two.
        cameras: Estimates by name.
        led_offset: Light in the wrist frame, shape (3,) [m].
        chi2_per_dof: About 1 if the noise is as stated; NaN without redundancy.
        points_used: Number of used poses.
        rejected: Reasons for poses that were left out: pose, camera, reason.
        verdicts: Reasons not to use the estimate.
        expected_reprojection_px: RMS over the workspace [px]; NaN if unknown.
        expected_triangulation_mm: RMS over the workspace [mm]; NaN if unknown.
        directory: Folder of plots and camera files, on the host of the machine.
        report: The whole report, as in ``report.json``.
    """

    success: bool
    message: str
    cameras: dict[str, CalibratedCamera]
    led_offset: Array
    chi2_per_dof: float
    points_used: int
    rejected: tuple[Mapping[str, Any], ...]
    verdicts: tuple[str, ...]
    expected_reprojection_px: float
    expected_triangulation_mm: float
    directory: Path
    report: Mapping[str, Any]

    @classmethod
    def of(cls, results: Mapping[str, Any]) -> "Calibration":
        """Return the calibration in the results of a command."""
        report = results["report"]
        expected = report["expected_error"]
        return cls(
            success=report["success"],
            message=report["message"],
            cameras={camera["name"]: _camera(camera) for camera in report["cameras"]},
            led_offset=_array(report["led_offset_m"]),
            chi2_per_dof=float(_array(report["chi2_per_dof"])),
            points_used=report["points_used"],
            rejected=tuple(report["points_rejected"]),
            verdicts=tuple("{kind}: {reason} {advice}".format(**verdict) for verdict in report["verdicts"]),
            expected_reprojection_px=float(_array(expected["reprojection_px"])),
            expected_triangulation_mm=float(_array(expected["triangulation_mm"])),
            directory=Path(results["directory"]),
            report=report,
        )


def _camera(told: Mapping[str, Any]) -> CalibratedCamera:
    return CalibratedCamera(
        name=told["name"],
        size=(told["width"], told["height"]),
        K=_array(told["K"]),
        D=_array(told["D"]),
        distortion_model=told["distortion_model"],
        R_cam_base=_array(told["R_cam_base"]),
        t_cam_base=_array(told["t_cam_base_m"]),
        rms_px=float(_array(told["rms_px"])),
        spots_used=told["spots_used"],
        covariance=_array(told["covariance"]),
    )


def _array(values: Any) -> Array:
    """Return an array of numbers; None becomes NaN."""
    return np.array(values, dtype=float)
