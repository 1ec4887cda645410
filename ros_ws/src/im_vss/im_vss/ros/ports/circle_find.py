"""Port of the Service ``circle_find``."""

import json
from typing import ClassVar

from im_msgs.msg import Ellipse
from im_msgs.srv import CircleFind
from im_vss.edges import EllipseFit
from im_vss.ros.messages import from_region, to_time
from im_vss.ros.ports.port import Port
from im_vss.services.svc_circle_find import CircleFindRequest, CircleFindResult


class CircleFindPort(Port):
    """`im_msgs/srv/CircleFind`."""

    kind: ClassVar[type] = CircleFind

    def request(self, message: CircleFind.Request) -> CircleFindRequest:
        """Camera, region and radii."""
        region = from_region(message.region)
        return CircleFindRequest(message.camera, message.exposure, region, message.radius_min, message.radius_max)

    def answer(self, result: CircleFindResult, response: CircleFind.Response) -> None:
        """The ellipses."""
        response.stamp = to_time(result.stamp_ns)
        response.circles = [to_ellipse(circle) for circle in result.found]
        response.cause = "" if result.found else "nothing in the image is a circle of the given size"
        response.timing_json = json.dumps(result.timing)


def to_ellipse(circle: EllipseFit) -> Ellipse:
    """A circle as a message; `fit.contrast` is positive where the outside is the brighter side."""
    return Ellipse(
        u=circle.u,
        v=circle.v,
        covariance=circle.covariance.ravel(),
        major=circle.major,
        minor=circle.minor,
        angle=circle.angle,
        dark=circle.fit.contrast > 0.0,
        rms=circle.rms,
        coverage=circle.coverage,
    )
