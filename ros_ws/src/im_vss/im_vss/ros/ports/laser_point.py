"""Port of the Service ``laser_point``."""

from typing import ClassVar

import numpy as np

from im_msgs.srv import LaserPoint
from im_vss.ros.messages import to_time
from im_vss.ros.ports.port import Port
from im_vss.services.svc_laser_point import LaserPointRequest, LaserPointResult


class LaserPointPort(Port):
    """`im_msgs/srv/LaserPoint`."""

    kind: ClassVar[type] = LaserPoint

    def request(self, message: LaserPoint.Request) -> LaserPointRequest:
        """Angles or target."""
        first, second = (float(angle) for angle in message.angles)
        place = message.target
        target = np.array([place.x, place.y, place.z]) if message.to_target else None
        return LaserPointRequest((first, second), target, message.on)

    def answer(self, result: LaserPointResult, response: LaserPoint.Response) -> None:
        """Where the mirrors are."""
        response.angles = [result.beam.mirror1, result.beam.mirror2]
        response.lit = result.beam.power > 0.0
        response.calibrated = result.calibrated
        response.stamp = to_time(result.stamp_ns)
