"""``python -m bench.dom.bare``: two services of the types of ``/dom`` that keep what they are given in a dictionary.

What ROS itself costs: no store, no check, nobody is told of changes.
"""

import sys
from array import array

from im_core.ros import qos, run
from im_core.ros.node import ManagedNode
from im_msgs.srv import GetObject, PutObject

PUT, GET = "/bare/put", "/bare/get"


class BareNode(ManagedNode):
    """Puts and gets, and nothing else."""

    def __init__(self) -> None:
        super().__init__("bare")
        self._data: dict[str, array[int]] = {}
        self.create_service(PutObject, PUT, self._put, qos_profile=qos.QUEUED_SERVICE)
        self.create_service(GetObject, GET, self._get, qos_profile=qos.QUEUED_SERVICE)

    def _put(self, request: PutObject.Request, response: PutObject.Response) -> PutObject.Response:
        self._data[request.name] = array("B", request.data)
        response.success = True
        return response

    def _get(self, request: GetObject.Request, response: GetObject.Response) -> GetObject.Response:
        response.data = self._data[request.name]
        response.success = True
        return response


if __name__ == "__main__":
    sys.exit(run.main(BareNode))
