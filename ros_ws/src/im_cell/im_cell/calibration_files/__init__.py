"""Calibrations as files: what one run leaves behind and the next one can be started with.

A folder holds ``<camera>.yaml`` (intrinsics, in the format of ROS's `camera_info_manager`), ``extrinsics.yaml`` (poses,
a `tf2_msgs/TFMessage` in YAML) and ``laser.yaml``; each may be absent.
"""

from im_cell.calibration_files.extrinsics import EXTRINSICS, CameraPose, extrinsics_yaml, frame_of
from im_cell.calibration_files.folder import CalibrationFiles, read_calibration
from im_cell.calibration_files.intrinsics import Rectified, camera_info_yaml, monocular
from im_cell.calibration_files.laser import LASER, LaserEstimate, laser_yaml

__all__ = [
    "EXTRINSICS",
    "LASER",
    "CalibrationFiles",
    "CameraPose",
    "LaserEstimate",
    "Rectified",
    "camera_info_yaml",
    "extrinsics_yaml",
    "frame_of",
    "laser_yaml",
    "monocular",
    "read_calibration",
]
