"""Ports of the Services of images: snap, spots, circles, lines, fiducials."""

import json
from dataclasses import replace
from typing import Any, ClassVar

from im_core.ros.messages.stamps import to_stamp
from im_msgs.msg import Ellipse, Fiducial, LineSegment
from im_msgs.srv import CircleFind, FiducialPose, LineFind, Snap, SpotFind, SpotFindStereo, SpotLook
from im_vss.edges import EllipseFit, LineFit
from im_vss.ros.messages import (
    from_region,
    to_camera_info,
    to_candidates,
    to_header,
    to_image,
    to_pose,
    to_spot,
    to_view,
)
from im_vss.ros.ports.port import Port
from im_vss.services.features import (
    CircleFindRequest,
    CircleFindResult,
    FiducialPoseRequest,
    FiducialPoseResult,
    LineFindRequest,
    LineFindResult,
    SeenFiducial,
)
from im_vss.services.laser import LaserSpot3dResult
from im_vss.services.snap import SnapRequest, SnapResult
from im_vss.services.spot import (
    SpotFindRequest,
    SpotFindResult,
    SpotFindStereoResult,
)


class CamerasPort(Port):
    """Port of Services that are asked for cameras and an exposure."""

    def request(self, message: Any) -> SnapRequest:
        """Read cameras and exposure."""
        return SnapRequest(tuple(message.cameras), message.exposure)


class SnapPort(CamerasPort):
    """`im_msgs/srv/Snap`."""

    kind: ClassVar[type] = Snap

    def answer(self, result: SnapResult, response: Snap.Response) -> None:
        """Fill in images and camera infos, of the same stamps."""
        for frame in result.frames:
            entry = self.rig.book[frame.camera]
            response.images.append(to_image(entry.frame, frame.stamp_ns, frame.image))
            response.camera_infos.append(to_camera_info(entry, frame.stamp_ns))
        response.timing_json = json.dumps(result.timing)


class SpotFindPort(Port):
    """`im_msgs/srv/SpotFind`."""

    kind: ClassVar[type] = SpotFind

    def request(self, message: SpotFind.Request) -> SpotFindRequest:
        """Read cameras and exposure, or a look, and the target."""
        return SpotFindRequest(tuple(message.cameras), message.exposure, message.look, message.target)

    def answer(self, result: SpotFindResult, response: SpotFind.Response) -> None:
        """Fill in a spot, or the cause of the absence, and the candidates, for each camera; of a target, the views."""
        response.spots = [to_spot(spot) for spot in result.spots]
        response.candidates = [to_candidates(spot) for spot in result.spots]
        response.views = [to_view(view) for view in result.views]
        response.timing_json = json.dumps(result.timing)


class SpotLookPort(Port):
    """`im_msgs/srv/SpotLook`."""

    kind: ClassVar[type] = SpotLook

    def request(self, message: SpotLook.Request) -> SpotFindRequest:
        """Read cameras, exposure and target."""
        return SpotFindRequest(tuple(message.cameras), message.exposure, target=message.target)

    def answer(self, result: str, response: SpotLook.Response) -> None:
        """The name of the look."""
        response.look = result


class SpotFindStereoPort(CamerasPort):
    """`im_msgs/srv/SpotFindStereo`."""

    kind: ClassVar[type] = SpotFindStereo

    def answer(self, result: SpotFindStereoResult, response: SpotFindStereo.Response) -> None:
        """Fill in the point, or the cause of the absence, and the finding of each camera."""
        fill_point(response, result)
        response.candidates = [to_candidates(seen) for seen in result.spots]


def fill_point(response: Any, result: SpotFindStereoResult | LaserSpot3dResult) -> None:
    """Fill in the point of two cameras, or the cause of the absence, and the finding of each camera."""
    stereo = result.stereo
    response.cause, response.epipolar_distance = stereo.cause, stereo.epipolar_px
    response.point.header = to_header("world", result.spots[0].stamp_ns)
    if stereo.point is not None:
        response.found = True
        place = response.point.point
        place.x, place.y, place.z = (float(value) for value in stereo.point.position)
        response.covariance = stereo.point.covariance.ravel()
    for seen, chosen in zip(result.spots, stereo.spots, strict=True):
        finding = seen.finding if chosen is None else replace(seen.finding, spot=chosen, cause="")
        response.spots.append(to_spot(replace(seen, finding=finding)))
    response.status.message = result.remark
    response.timing_json = json.dumps(result.timing)


class CircleFindPort(Port):
    """`im_msgs/srv/CircleFind`."""

    kind: ClassVar[type] = CircleFind

    def request(self, message: CircleFind.Request) -> CircleFindRequest:
        """Camera, region and radii."""
        region = from_region(message.region)
        return CircleFindRequest(message.camera, message.exposure, region, message.radius_min, message.radius_max)

    def answer(self, result: CircleFindResult, response: CircleFind.Response) -> None:
        """The ellipses."""
        response.stamp = to_stamp(result.stamp_ns)
        response.circles = [to_ellipse(circle) for circle in result.found]
        response.cause = "" if result.found else "nothing in the image is a circle of the given size"
        response.timing_json = json.dumps(result.timing)


def to_ellipse(circle: EllipseFit) -> Ellipse:
    """Convert a circle to a message; `fit.contrast` is positive where the outside is the brighter side."""
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


class LineFindPort(Port):
    """`im_msgs/srv/LineFind`."""

    kind: ClassVar[type] = LineFind

    def request(self, message: LineFind.Request) -> LineFindRequest:
        """Camera, region and length."""
        return LineFindRequest(message.camera, message.exposure, from_region(message.region), message.length_min)

    def answer(self, result: LineFindResult, response: LineFind.Response) -> None:
        """The lines."""
        response.stamp = to_stamp(result.stamp_ns)
        response.lines = [to_segment(line) for line in result.found]
        response.cause = "" if result.found else "nothing in the image is a straight edge of the given length"
        response.status.message = result.remark
        response.timing_json = json.dumps(result.timing)


def to_segment(line: LineFit) -> LineSegment:
    """Convert a line to a message."""
    return LineSegment(
        start=line.start,
        end=line.end,
        covariance=line.covariance.ravel(),
        rms=line.rms,
        contrast=line.edge.fit.contrast,
        points=line.edge.points,
    )


class FiducialPosePort(Port):
    """`im_msgs/srv/FiducialPose`."""

    kind: ClassVar[type] = FiducialPose

    def request(self, message: FiducialPose.Request) -> FiducialPoseRequest:
        """Read cameras and numbers."""
        return FiducialPoseRequest(tuple(message.cameras), tuple(message.ids), message.exposure)

    def answer(self, result: FiducialPoseResult, response: FiducialPose.Response) -> None:
        """The plates."""
        response.fiducials = [self._fiducial(seen) for seen in result.found]
        response.cause = result.cause
        response.status.message = result.remark
        response.timing_json = json.dumps(result.timing)

    def _fiducial(self, seen: SeenFiducial) -> Fiducial:
        fit, pose = seen.fit, seen.fit.pose
        message = Fiducial(
            camera=seen.camera,
            id=fit.target.id,
            name=fit.target.name,
            corners=fit.corners.ravel(),
            rms=pose.rms_px,
            ambiguity=fit.ambiguity,
        )
        message.pose.header = to_header(self.rig.book[seen.camera].frame, seen.stamp_ns)
        message.pose.pose.covariance = pose.covariance.ravel()
        message.pose.pose.pose = to_pose(pose.translation, pose.rotation)
        return message
