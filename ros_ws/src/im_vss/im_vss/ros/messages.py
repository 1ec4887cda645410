"""Between the Vision Services System's types and messages."""

from dataclasses import replace

import cv2
import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Transform, TransformStamped, Vector3
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, RegionOfInterest
from std_msgs.msg import Header

from im_cell.calibration_files import folded, implausible
from im_cell.camera_model import CameraModel
from im_cell.lens import PLUMB_BOB, lens_of
from im_cell.rotations import quaternion_of_matrix
from im_core.errors import DataError
from im_core.ros.messages.stamps import to_stamp
from im_msgs.msg import Spot, SpotCandidates, TargetView
from im_vss.camera_book import CameraEntry
from im_vss.services.spot import CameraSpot, CameraView
from im_vss.tools.display import NOT_SEEN
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


def to_compressed(frame: str, stamp_ns: int, image: NDArray[np.uint8]) -> CompressedImage:
    """Convert a grey image, shape (h, w), to a message with a JPEG, its format named as by image_transport."""
    _, data = cv2.imencode(".jpg", image)
    return CompressedImage(header=to_header(frame, stamp_ns), format="mono8; jpeg compressed ", data=data.tobytes())


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


def to_transform(parent: str, frame: str, position: Array, rotation: Array, stamp_ns: int) -> TransformStamped:
    """Return the place of a frame in the parent as a message; arguments as of :func:`to_pose`."""
    pose = to_pose(position, rotation)
    shift = Vector3(x=pose.position.x, y=pose.position.y, z=pose.position.z)
    transform = Transform(translation=shift, rotation=pose.orientation)
    return TransformStamped(header=to_header(parent, stamp_ns), child_frame_id=frame, transform=transform)


def to_pose(position: Array, rotation: Array) -> Pose:
    """Return a position, shape (3,) [m], and a rotation, shape (3, 3), as a message."""
    x, y, z = position.tolist()
    turn = Quaternion(**dict(zip("xyzw", quaternion_of_matrix(rotation), strict=True)))
    return Pose(position=Point(x=x, y=y, z=z), orientation=turn)


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


def to_view(seen: CameraView) -> TargetView:
    """Convert the view of a target to a message."""
    message = TargetView(camera=seen.camera, stamp=to_stamp(seen.stamp_ns))
    if seen.found is None:
        message.cause = f"it {NOT_SEEN}"
        return message
    message.found = True
    message.u, message.v = seen.found.points.T.tolist()
    message.sd = seen.found.standard_deviations.tolist()
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
