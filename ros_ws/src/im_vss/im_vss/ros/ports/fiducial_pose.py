"""Port of the Service ``fiducial_pose``."""

import json
from typing import ClassVar

from im_msgs.msg import Fiducial
from im_msgs.srv import FiducialPose
from im_vss.ros.messages import quaternion, to_header
from im_vss.ros.ports.port import Port
from im_vss.services.svc_fiducial_pose import FiducialPoseRequest, FiducialPoseResult, SeenFiducial


class FiducialPosePort(Port):
    """`im_msgs/srv/FiducialPose`."""

    kind: ClassVar[type] = FiducialPose

    def request(self, message: FiducialPose.Request) -> FiducialPoseRequest:
        """Cameras and numbers."""
        return FiducialPoseRequest(tuple(message.cameras), tuple(message.ids), message.exposure)

    def answer(self, result: FiducialPoseResult, response: FiducialPose.Response) -> None:
        """The plates."""
        response.fiducials = [self._fiducial(seen) for seen in result.found]
        response.cause = result.cause
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
        target = message.pose.pose.pose
        target.position.x, target.position.y, target.position.z = (float(value) for value in pose.translation)
        q = target.orientation
        q.x, q.y, q.z, q.w = quaternion(pose.rotation)
        return message
