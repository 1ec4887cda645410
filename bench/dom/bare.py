"""``python -m bench.dom.bare``: two services of the types of ``/dom`` that keep what they are given in a dictionary.

What ROS itself costs, for requests and answers of the same size: no store, no check, nobody is told of changes.
"""

import sys
from array import array

from im_core.ros import qos, run
from im_core.ros.messages.status import OK
from im_core.ros.node import ManagedNode
from im_msgs.srv import GetObject, PutObject

PUT, GET = "/bare/put", "/bare/get"
KIND, HASH = "std_msgs/msg/UInt8MultiArray", f"RIHS01_{64 * '0'}"


class BareNode(ManagedNode):
    """Puts and gets, and nothing else."""

    def __init__(self) -> None:
        super().__init__("bare")
        self._data: dict[str, array[int]] = {}
        self.create_service(PutObject, PUT, self._put, qos_profile=qos.QUEUED_SERVICE)
        self.create_service(GetObject, GET, self._get, qos_profile=qos.QUEUED_SERVICE)

    def _put(self, request: PutObject.Request, response: PutObject.Response) -> PutObject.Response:
        self._data[request.name] = array("B", request.data)
        self._tell(response, request.name)
        response.object.source = request.source
        return response

    def _get(self, request: GetObject.Request, response: GetObject.Response) -> GetObject.Response:
        response.data = self._data[request.name]
        self._tell(response, request.name)
        return response

    def _tell(self, response: PutObject.Response | GetObject.Response, name: str) -> None:
        """Fills an answer as ``/dom`` does."""
        info, data = response.object, self._data[name]
        info.name, info.type, info.type_hash = name, KIND, HASH
        info.version, info.valid, info.size = 1, True, len(data)
        response.success, response.status.code = True, OK


if __name__ == "__main__":
    sys.exit(run.main(BareNode))
