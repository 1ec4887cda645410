"""Port of the Service ``laser_spot_3d``."""

import json
from dataclasses import replace
from typing import ClassVar

from im_msgs.srv import LaserSpot3d
from im_vss.ros.messages import to_header, to_spot
from im_vss.ros.ports.port import Port
from im_vss.services.svc_laser_spot_3d import LaserSpot3dRequest, LaserSpot3dResult


class LaserSpot3dPort(Port):
    """`im_msgs/srv/LaserSpot3d`."""

    kind: ClassVar[type] = LaserSpot3d

    def request(self, message: LaserSpot3d.Request) -> LaserSpot3dRequest:
        """Cameras and angles."""
        first, second = (float(angle) for angle in message.angles)
        angles = None if message.present else (first, second)
        return LaserSpot3dRequest(tuple(message.cameras), angles, message.exposure)

    def answer(self, result: LaserSpot3dResult, response: LaserSpot3d.Response) -> None:
        """The point, or why there is none; what each camera saw."""
        stereo = result.stereo
        response.cause, response.epipolar_distance = stereo.cause, stereo.epipolar_px
        response.angles = [result.beam.mirror1, result.beam.mirror2]
        response.point.header = to_header("world", result.spots[0].stamp_ns)
        if stereo.point is not None:
            response.found = True
            place = response.point.point
            place.x, place.y, place.z = (float(value) for value in stereo.point.position)
            response.covariance = stereo.point.covariance.ravel()
        for seen, chosen in zip(result.spots, stereo.spots, strict=True):
            finding = seen.finding if chosen is None else replace(seen.finding, spot=chosen, cause="")
            response.spots.append(to_spot(replace(seen, finding=finding)))
        response.timing_json = json.dumps(result.timing)
