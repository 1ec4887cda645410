"""Port of the Service ``spot_find``."""

import json
from typing import ClassVar

from im_msgs.srv import SpotFind
from im_vss.ros.messages import to_candidates, to_spot
from im_vss.ros.ports.port import Port
from im_vss.services.svc_spot_find import SpotFindRequest, SpotFindResult


class SpotFindPort(Port):
    """`im_msgs/srv/SpotFind`."""

    kind: ClassVar[type] = SpotFind

    def request(self, message: SpotFind.Request) -> SpotFindRequest:
        """Cameras and exposure."""
        return SpotFindRequest(tuple(message.cameras), message.exposure)

    def answer(self, result: SpotFindResult, response: SpotFind.Response) -> None:
        """A spot, or the cause of its absence, and the candidates, for each camera."""
        response.spots = [to_spot(spot) for spot in result.spots]
        response.candidates = [to_candidates(spot) for spot in result.spots]
        response.timing_json = json.dumps(result.timing)
