"""Port of the Service ``snap``."""

import json
from typing import ClassVar

from im_msgs.srv import Snap
from im_vss.ros.messages import to_camera_info, to_image
from im_vss.ros.ports.port import Port
from im_vss.services.svc_snap import SnapRequest, SnapResult


class SnapPort(Port):
    """`im_msgs/srv/Snap`."""

    kind: ClassVar[type] = Snap

    def request(self, message: Snap.Request) -> SnapRequest:
        """Cameras and exposure."""
        return SnapRequest(tuple(message.cameras), message.exposure)

    def answer(self, result: SnapResult, response: Snap.Response) -> None:
        """Images and camera infos, of the same stamps."""
        for frame in result.frames:
            entry = self.rig.book[frame.camera]
            response.images.append(to_image(entry.frame, frame.stamp_ns, frame.image))
            response.camera_infos.append(to_camera_info(entry, frame.stamp_ns))
        response.timing_json = json.dumps(result.timing)
