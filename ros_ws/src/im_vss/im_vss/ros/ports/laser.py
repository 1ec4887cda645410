"""Port of the Service ``line_scan``."""

import json
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from im_msgs.srv import LineScan
from im_vss.ros.messages import to_header
from im_vss.ros.ports.port import Port
from im_vss.services.svc_line_scan import LineScanRequest, LineScanResult

_FIELDS = ("x", "y", "z", "intensity")


class LineScanPort(Port):
    """`im_msgs/srv/LineScan`."""

    kind: ClassVar[type] = LineScan

    def request(self, message: LineScan.Request) -> LineScanRequest:
        """Cameras and angles."""
        span, sweep = ((float(pair[0]), float(pair[1])) for pair in (message.span, message.sweep))
        return LineScanRequest(tuple(message.cameras), span, sweep, message.lines, message.exposure)

    def answer(self, result: LineScanResult, response: LineScan.Response) -> None:
        """The points, and what was rejected."""
        response.cloud = to_cloud(result.points, result.brightness, result.stamp_ns)
        response.count = len(result.points)
        response.causes, response.rejected = list(result.rejected), list(result.rejected.values())
        response.timing_json = json.dumps(result.timing)


def to_cloud(points: NDArray[np.float64], intensity: NDArray[np.float64], stamp_ns: int) -> PointCloud2:
    """Points in the world, shape (n, 3) [m], with intensities, shape (n,), as a message of 32-bit numbers."""
    values = np.column_stack((points, intensity)).astype("<f4")
    message = PointCloud2(
        header=to_header("world", stamp_ns),
        height=1,
        width=len(values),
        fields=[
            PointField(name=name, offset=4 * rank, datatype=PointField.FLOAT32, count=1)
            for rank, name in enumerate(_FIELDS)
        ],
        is_bigendian=False,
        point_step=values.itemsize * len(_FIELDS),
        row_step=values.nbytes,
        is_dense=True,
    )
    message.data = values.tobytes()
    return message
