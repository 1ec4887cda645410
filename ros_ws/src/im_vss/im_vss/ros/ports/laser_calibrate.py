"""Port of the Service ``laser_calibrate``."""

from typing import ClassVar

import numpy as np

from im_msgs.srv import LaserCalibrate
from im_vss.ros.messages import quaternion
from im_vss.ros.ports.port import Port
from im_vss.services.svc_laser_calibrate import LaserCalibrateRequest, LaserCalibrateResult


class LaserCalibratePort(Port):
    """`im_msgs/srv/LaserCalibrate`."""

    kind: ClassVar[type] = LaserCalibrate

    def request(self, message: LaserCalibrate.Request) -> LaserCalibrateRequest:
        """Cameras and angles."""
        return LaserCalibrateRequest(
            tuple(message.cameras), tuple(message.mirror1), tuple(message.mirror2), message.apply
        )

    def answer(self, result: LaserCalibrateResult, response: LaserCalibrate.Response) -> None:
        """The estimate."""
        found = result.calibration
        response.verdicts = list(found.verdicts)
        position, q = response.pose.position, response.pose.orientation
        position.x, position.y, position.z = (float(value) for value in found.model.position)
        q.x, q.y, q.z, q.w = quaternion(found.model.rotation)
        response.gain = list(map(float, found.model.gain))
        response.offset, response.gap = float(found.model.offset), float(found.model.gap)
        if np.all(np.isfinite(found.covariance)):
            response.covariance = found.covariance.ravel().tolist()
        response.rms, response.chi2_per_dof = found.rms_m, found.chi2_per_dof
        response.spots_used = int(found.used.sum())
        response.rejected = list(result.rejected)
        response.applied = result.file is not None
        response.file = str(result.file or "")
