"""Node ``/dom``."""

import sys
from collections.abc import Callable
from typing import TypeVar

from im_core.errors import ImError, StateError
from im_core.names import run_dir
from im_core.ros import qos, run
from im_core.ros.node import ManagedNode
from im_core.ros.status import ok_status, to_status
from im_core.ros.worker import Worker
from im_dom.store import ObjectRecord, ObjectStore
from im_msgs.msg import ObjectChange, ObjectInfo
from im_msgs.srv import GetObject, InvalidateObject, ListObjects, PutObject

#: How long the store may take to answer [s].
ANSWER_S = 5.0

AnswerT = TypeVar("AnswerT", PutObject.Response, GetObject.Response, InvalidateObject.Response)


class DomNode(ManagedNode):
    """ROS shell of :class:`im_dom.store.ObjectStore`; translates messages, decides nothing."""

    def __init__(self) -> None:
        super().__init__("dom")
        self._store: ObjectStore | None = None
        self._worker = Worker(self, "the objects' store", ANSWER_S)

    def phase_configure(self) -> None:
        """Open the store and offer the services."""
        self._store = ObjectStore(run_dir() / "dom.sqlite")
        self._changes = self.create_publisher(ObjectChange, "/dom/changes", qos.EVENTS)
        self.create_service(PutObject, "/dom/put", self._put)
        self.create_service(GetObject, "/dom/get", self._get)
        self.create_service(ListObjects, "/dom/list", self._list)
        self.create_service(InvalidateObject, "/dom/invalidate", self._invalidate)

    def phase_shutdown(self) -> None:
        """Close the store, unless something in it hangs."""
        if self._worker.close() and self._store is not None:
            self._store.close()

    @property
    def store(self) -> ObjectStore:
        """The objects, once the node is configured.

        Raises:
            StateError: It is not.
        """
        if self._store is None:
            raise StateError("the objects' store is not open yet")
        return self._store

    async def _put(self, request: PutObject.Request, response: PutObject.Response) -> PutObject.Response:
        def put() -> ObjectRecord:
            return self.store.put(
                request.name, request.type, bytes(request.data), request.place, request.source, self._now_ns()
            )

        return await self._answer(response, put, changed=True)

    async def _get(self, request: GetObject.Request, response: GetObject.Response) -> GetObject.Response:
        def get() -> ObjectRecord:
            record, data = self.store.get(request.name, request.type)
            if not request.metadata_only:
                response.data = data
            return record

        return await self._answer(response, get, changed=False)

    async def _invalidate(
        self, request: InvalidateObject.Request, response: InvalidateObject.Response
    ) -> InvalidateObject.Response:
        def invalidate() -> ObjectRecord:
            return self.store.invalidate(request.name, request.source, self._now_ns())

        return await self._answer(response, invalidate, changed=True)

    async def _list(self, request: ListObjects.Request, response: ListObjects.Response) -> ListObjects.Response:
        records = await self._worker.run(lambda: self.store.records(request.prefix))
        response.objects = [to_info(record) for record in records]
        return response

    async def _answer(self, response: AnswerT, operation: Callable[[], ObjectRecord], changed: bool) -> AnswerT:
        try:
            response.object = to_info(await self._worker.run(operation))
        except ImError as error:
            response.success, response.status = False, to_status(error)
            return response
        response.success, response.status = True, ok_status()
        if changed:
            self._changes.publish(ObjectChange(object=response.object))
        return response

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def to_info(record: ObjectRecord) -> ObjectInfo:
    """The message of a record."""
    info = ObjectInfo(
        name=record.name,
        type=record.type,
        version=record.version,
        valid=record.valid,
        place=record.place,
        source=record.source,
        size=record.size,
    )
    info.stamp.sec, info.stamp.nanosec = divmod(record.stamp_ns, 10**9)
    return info


def main() -> None:
    """Run ``/dom``."""
    sys.exit(run.main(DomNode))


if __name__ == "__main__":
    main()
