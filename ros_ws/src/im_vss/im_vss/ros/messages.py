"""Between the Vision Services System's types and messages."""

from dataclasses import replace

import numpy as np
from geometry_msgs.msg import TransformStamped
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, RegionOfInterest
from std_msgs.msg import Header

from im_cell.calibration_files import folded, implausible
from im_cell.camera_model import CameraModel
from im_cell.laser_model import LaserModel
from im_cell.lens import PLUMB_BOB, lens_of
from im_core.errors import DataError
from im_core.ros.stamps import to_stamp
from im_msgs.msg import Spot, SpotCandidates
from im_vss.camera_book import CameraEntry
from im_vss.services.spot import CameraSpot
from im_vss.tools.spot import Region

Array = NDArray[np.float64]

_ENCODINGS = {2: "mono8", 3: "rgb8"}


def to_header(frame: str, stamp_ns: int) -> Header:
    """Header of an image or camera info."""
    return Header(stamp=to_stamp(stamp_ns), frame_id=frame)


def to_image(frame: str, stamp_ns: int, image: NDArray[np.uint8]) -> Image:
    """Convert a grey image, shape (h, w), or a red-green-blue one, shape (h, w, 3), to a message."""
    height, width = image.shape[:2]
    message = Image(
        header=to_header(frame, stamp_ns),
        height=height,
        width=width,
        encoding=_ENCODINGS[image.ndim],
        is_bigendian=0,
        step=width * (1 if image.ndim == 2 else image.shape[2]),
    )
    message.data = image.tobytes()
    return message


def to_camera_info(entry: CameraEntry, stamp_ns: int) -> CameraInfo:
    """Return the present calibration of a camera; K, R, P and D are zero, by convention, until the lens is known."""
    model, header = entry.model, to_header(entry.frame, stamp_ns)
    if entry.intrinsics_file is None:
        return CameraInfo(header=header, width=model.width, height=model.height)
    return CameraInfo(
        header=header,
        width=model.width,
        height=model.height,
        distortion_model=model.distortion_model,
        d=model.D.tolist(),
        k=model.K.ravel(),
        r=entry.rectified.R.ravel(),
        p=entry.rectified.P.ravel(),
    )


def from_camera_info(info: CameraInfo) -> CameraModel:
    """Return intrinsics and lens of a camera info.

    Raises:
        DataError: It is not finite, its lens model is unknown or has other coefficients, or no camera is like that.
    """
    lens = lens_of(info.distortion_model or PLUMB_BOB.name)
    D = lens.all_of(info.d) if len(info.d) else np.zeros(len(lens.coefficients))
    K = np.array(info.k).reshape(3, 3)
    if not np.array_equal(K[2], [0.0, 0.0, 1.0]) or K[1, 0] != 0.0 or K[0, 1] != 0.0:
        raise DataError(f"K = {K.ravel().tolist()} is not [fx 0 cx; 0 fy cy; 0 0 1]")
    if why_not := implausible(K, info.width, info.height):
        raise DataError(f"{why_not} of images of {info.width} x {info.height} px")
    model = CameraModel(info.width, info.height, K, D, distortion_model=lens.name)
    if why_not := folded(model):
        raise DataError(why_not)
    return model


def to_transform(entry: CameraEntry, stamp_ns: int) -> TransformStamped:
    """Return the pose of a camera's optical frame in the parent, as a message."""
    message = TransformStamped(header=to_header(entry.parent, stamp_ns), child_frame_id=entry.frame)
    position, target = entry.model.position, message.transform
    target.translation.x, target.translation.y, target.translation.z = (float(value) for value in position)
    x, y, z, w = quaternion(entry.model.R_cam_base.T)
    target.rotation.x, target.rotation.y, target.rotation.z, target.rotation.w = x, y, z, w
    return message


def to_spot(seen: CameraSpot) -> Spot:
    """Convert the finding of a camera to a message."""
    message = Spot(camera=seen.camera, stamp=to_stamp(seen.stamp_ns), cause=seen.finding.cause, snr=seen.finding.snr)
    spot = seen.finding.spot
    if spot is not None:
        message.found = True
        message.u, message.v = spot.u, spot.v
        message.covariance = spot.covariance.ravel()
        message.amplitude, message.sigma = spot.amplitude, spot.sigma
        message.saturated = spot.saturated > 0
    return message


def to_candidates(seen: CameraSpot) -> SpotCandidates:
    """Convert the candidates of the search in one camera to a message."""
    finding = seen.finding
    message = SpotCandidates(camera=seen.camera, stamp=to_stamp(seen.stamp_ns), refused=list(finding.refused))
    for candidate in finding.candidates:
        message.candidates.append(to_spot(replace(seen, finding=replace(finding, spot=candidate, cause=""))))
    if finding.region is not None:
        message.predicted = True
        message.u, message.v, message.radius = finding.region.u, finding.region.v, finding.region.radius
    return message


def from_region(region: RegionOfInterest) -> Region:
    """Return a part of an image from a message."""
    return Region(region.x_offset, region.y_offset, region.width, region.height)


def to_laser_transform(model: LaserModel, stamp_ns: int) -> TransformStamped:
    """Pose of the laser scanner in the world."""
    message = TransformStamped(header=to_header("world", stamp_ns), child_frame_id="laser_scanner")
    target = message.transform
    target.translation.x, target.translation.y, target.translation.z = (float(value) for value in model.position)
    x, y, z, w = quaternion(model.rotation)
    target.rotation.x, target.rotation.y, target.rotation.z, target.rotation.w = x, y, z, w
    return message


def quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a rotation, shape (3, 3), the largest element positive.

    Source: Shepperd, "Quaternion from rotation matrix" (1978).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    products = np.array(  # four times the product of each two elements
        [
            [1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz],
        ]
    )
    largest = products[products.diagonal().argmax()]
    x, y, z, w = (largest / np.linalg.norm(largest)).tolist()
    return x, y, z, w
