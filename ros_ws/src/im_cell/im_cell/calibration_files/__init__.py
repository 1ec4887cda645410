"""Calibrations as files: results of one run, and starting values of the next one.

A folder holds ``<camera>.yaml`` (intrinsics, in the format of ROS's `camera_info_manager`), ``extrinsics.yaml`` (poses,
a `tf2_msgs/TFMessage` in YAML), ``covariance.yaml`` (how well both are known) and ``laser.yaml``; each may be absent.
Those of the cameras are changed together, see :mod:`im_cell.calibration_files.together`.
"""

from im_cell.calibration_files.covariance import COVARIANCE, covariance_yaml
from im_cell.calibration_files.extrinsics import EXTRINSICS, CameraPose, extrinsics_yaml, frame_of
from im_cell.calibration_files.folder import CalibrationFiles, read_calibration
from im_cell.calibration_files.intrinsics import Rectified, camera_info_yaml, folded, implausible, monocular
from im_cell.calibration_files.laser import LASER, LaserEstimate, laser_yaml
from im_cell.calibration_files.together import camera_files, change_camera_files

__all__ = [
    "COVARIANCE",
    "EXTRINSICS",
    "LASER",
    "CalibrationFiles",
    "CameraPose",
    "LaserEstimate",
    "Rectified",
    "camera_files",
    "camera_info_yaml",
    "change_camera_files",
    "covariance_yaml",
    "extrinsics_yaml",
    "folded",
    "frame_of",
    "implausible",
    "laser_yaml",
    "monocular",
    "read_calibration",
]
