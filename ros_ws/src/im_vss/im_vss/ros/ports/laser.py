"""Ports of the Services of the laser scanner: pointing, spots, scans, calibration."""

import json
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from im_core.ros.messages.stamps import to_stamp
from im_msgs.srv import LaserCalibrate, LaserPoint, LaserSpot3d, LineScan
from im_vss.ros.messages import to_header, to_pose
from im_vss.ros.ports.images import fill_point
from im_vss.ros.ports.port import Port
from im_vss.services.laser import (
    LaserCalibrateRequest,
    LaserCalibrateResult,
    LaserPointRequest,
    LaserPointResult,
    LaserSpot3dRequest,
    LaserSpot3dResult,
    LineScanRequest,
    LineScanResult,
)

_FIELDS = ("x", "y", "z", "intensity")


class LaserPointPort(Port):
    """`im_msgs/srv/LaserPoint`."""

    kind: ClassVar[type] = LaserPoint

    def request(self, message: LaserPoint.Request) -> LaserPointRequest:
        """Read angles or target."""
        first, second = (float(angle) for angle in message.angles)
        place = message.target
        target = np.array([place.x, place.y, place.z]) if message.to_target else None
        return LaserPointRequest((first, second), target, message.on)

    def answer(self, result: LaserPointResult, response: LaserPoint.Response) -> None:
        """Where the mirrors are."""
        response.angles = [result.beam.mirror1, result.beam.mirror2]
        response.lit = result.beam.power > 0.0
        response.calibrated = result.calibrated
        response.stamp = to_stamp(result.stamp_ns)


class LaserSpot3dPort(Port):
    """`im_msgs/srv/LaserSpot3d`."""

    kind: ClassVar[type] = LaserSpot3d

    def request(self, message: LaserSpot3d.Request) -> LaserSpot3dRequest:
        """Read cameras and angles."""
        first, second = (float(angle) for angle in message.angles)
        angles = None if message.present else (first, second)
        return LaserSpot3dRequest(tuple(message.cameras), angles, message.exposure)

    def answer(self, result: LaserSpot3dResult, response: LaserSpot3d.Response) -> None:
        """Fill in the point, or the cause of the absence, and the finding of each camera."""
        fill_point(response, result)
        response.angles = [result.beam.mirror1, result.beam.mirror2]


class LineScanPort(Port):
    """`im_msgs/srv/LineScan`."""

    kind: ClassVar[type] = LineScan

    def request(self, message: LineScan.Request) -> LineScanRequest:
        """Read cameras and angles."""
        span, sweep = ((float(pair[0]), float(pair[1])) for pair in (message.span, message.sweep))
        return LineScanRequest(tuple(message.cameras), span, sweep, message.lines, message.exposure)

    def answer(self, result: LineScanResult, response: LineScan.Response) -> None:
        """Fill in the points, and the rejected ones."""
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


class LaserCalibratePort(Port):
    """`im_msgs/srv/LaserCalibrate`."""

    kind: ClassVar[type] = LaserCalibrate

    def request(self, message: LaserCalibrate.Request) -> LaserCalibrateRequest:
        """Read cameras and angles."""
        return LaserCalibrateRequest(
            tuple(message.cameras), tuple(message.mirror1), tuple(message.mirror2), message.apply
        )

    def answer(self, result: LaserCalibrateResult, response: LaserCalibrate.Response) -> None:
        """The estimate."""
        found = result.calibration
        response.verdicts = list(found.verdicts)
        response.pose = to_pose(found.model.position, found.model.rotation)
        response.gain = list(map(float, found.model.gain))
        response.offset, response.gap = float(found.model.offset), float(found.model.gap)
        if np.all(np.isfinite(found.covariance)):
            response.covariance = found.covariance.ravel().tolist()
        response.rms, response.chi2_per_dof = found.rms_m, found.chi2_per_dof
        response.spots_used = int(found.used.sum())
        response.rejected = list(result.rejected)
        response.applied = result.file is not None
        response.file = str(result.file or "")
        response.status.message = result.remark
