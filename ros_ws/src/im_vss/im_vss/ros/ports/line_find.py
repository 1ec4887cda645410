"""Port of the Service ``line_find``."""

import json
from typing import ClassVar

from im_msgs.msg import LineSegment
from im_msgs.srv import LineFind
from im_vss.edges import LineFit
from im_vss.ros.messages import from_region, to_time
from im_vss.ros.ports.port import Port
from im_vss.services.svc_line_find import LineFindRequest, LineFindResult


class LineFindPort(Port):
    """`im_msgs/srv/LineFind`."""

    kind: ClassVar[type] = LineFind

    def request(self, message: LineFind.Request) -> LineFindRequest:
        """Camera, region and length."""
        return LineFindRequest(message.camera, message.exposure, from_region(message.region), message.length_min)

    def answer(self, result: LineFindResult, response: LineFind.Response) -> None:
        """The lines."""
        response.stamp = to_time(result.stamp_ns)
        response.lines = [to_segment(line) for line in result.found]
        response.cause = "" if result.found else "nothing in the image is a straight edge of the given length"
        response.status.message = result.remark
        response.timing_json = json.dumps(result.timing)


def to_segment(line: LineFit) -> LineSegment:
    """A line as a message."""
    return LineSegment(
        start=line.start,
        end=line.end,
        covariance=line.edge.fit.covariance.ravel(),
        rms=line.rms,
        contrast=line.edge.fit.contrast,
        points=line.edge.points,
    )
