"""Port of the Service ``spot_find_stereo``."""

import json
from dataclasses import replace
from typing import ClassVar

from im_msgs.srv import SpotFindStereo
from im_vss.ros.messages import to_candidates, to_header, to_spot
from im_vss.ros.ports.port import Port
from im_vss.services.svc_spot_find_stereo import SpotFindStereoRequest, SpotFindStereoResult


class SpotFindStereoPort(Port):
    """`im_msgs/srv/SpotFindStereo`."""

    kind: ClassVar[type] = SpotFindStereo

    def request(self, message: SpotFindStereo.Request) -> SpotFindStereoRequest:
        """Cameras and exposure."""
        return SpotFindStereoRequest(tuple(message.cameras), message.exposure)

    def answer(self, result: SpotFindStereoResult, response: SpotFindStereo.Response) -> None:
        """The point, or why there is none; what each camera saw."""
        stereo = result.stereo
        response.cause, response.epipolar_distance = stereo.cause, stereo.epipolar_px
        response.point.header = to_header("world", result.spots[0].stamp_ns)
        if stereo.point is not None:
            response.found = True
            place = response.point.point
            place.x, place.y, place.z = (float(value) for value in stereo.point.position)
            response.covariance = stereo.point.covariance.ravel()
        for seen, chosen in zip(result.spots, stereo.spots, strict=True):
            response.candidates.append(to_candidates(seen))
            finding = seen.finding if chosen is None else replace(seen.finding, spot=chosen, cause="")
            response.spots.append(to_spot(replace(seen, finding=finding)))
        response.timing_json = json.dumps(result.timing)
