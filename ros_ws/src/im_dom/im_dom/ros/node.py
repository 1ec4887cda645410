"""Node ``/dom``."""

import sys
from array import array
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeVar

from diagnostic_msgs.msg import KeyValue

from im_core import clock
from im_core.errors import DataError, ImError, NotFoundError, StateError, WaitTimeoutError
from im_core.names import run_dir
from im_core.ros import qos, run
from im_core.ros.calls import pause, wait
from im_core.ros.coroutines import Promise
from im_core.ros.dom import DAMAGED, NOT_VALID, STORE_MARK
from im_core.ros.messages.status import OK, ok_status, to_status
from im_core.ros.node import ManagedNode
from im_core.ros.repeated_warnings import Reminders
from im_core.ros.worker import Worker
from im_dom.object_record import ObjectRecord
from im_dom.places import Places
from im_dom.ros.types import as_json, check_message, extended, from_json
from im_dom.store import ObjectStore
from im_msgs.msg import NetDescription, ObjectChange, ObjectInfo, Status
from im_msgs.srv import AppendObject, GetObject, InvalidateObject, ListObjects, PutObject

#: How long the store may take to answer [s]: it waits for a disk, to which others may write, too.
ANSWER_S = 30.0

#: How long a request may wait for an object to be valid [s], and how many may.
LONGEST_WAIT_S = 3600.0
MOST_WAITING = 1000

#: How soon the objects of places that have gone are looked at again, where the store could not do it [s].
ABANDON_AGAIN_S = 2.0

#: How long the net of a place may take to be described, as to a node that has just begun [s].
DESCRIBED_S = 5.0

ResultT = TypeVar("ResultT")
AnswerT = TypeVar("AnswerT", PutObject.Response, AppendObject.Response, GetObject.Response, InvalidateObject.Response)


class DomNode(ManagedNode):
    """ROS shell of :class:`im_dom.store.ObjectStore`; translates messages, decides nothing."""

    def __init__(self) -> None:
        super().__init__("dom")
        self._store: ObjectStore | None = None
        self._worker: Worker | None = None
        self._reminders = Reminders(self)
        self._awaited: dict[Promise, str] = {}
        self._places = Places()
        self._undescribed: list[Promise] = []
        self._last = KeyValue()
        self._change = ObjectChange()  # a new one would be filled with an object that nobody needs, at each change

    def phase_configure(self) -> None:
        """Open the store and offer the services."""
        self._store = ObjectStore(run_dir() / "dom.sqlite")
        self._found_damaged: set[str] = set()
        if self._store.aside:
            self._reminders.add("store", self._store.aside)
        self._worker = Worker(self, "the objects' store of /dom", ANSWER_S, self._store.together)
        self._changes = self.create_publisher(ObjectChange, "/dom/changes", qos.LATCHED_EVENTS)
        self.create_subscription(NetDescription, "/pnt/nets", self._described, qos.LATCHED_NETS)
        self.create_service(PutObject, "/dom/put", self._put, qos_profile=qos.QUEUED_SERVICE)
        self.create_service(AppendObject, "/dom/append", self._append, qos_profile=qos.QUEUED_SERVICE)
        self.create_service(GetObject, "/dom/get", self._get, qos_profile=qos.QUEUED_SERVICE)
        self.create_service(ListObjects, "/dom/list", self._list, qos_profile=qos.QUEUED_SERVICE)
        self.create_service(InvalidateObject, "/dom/invalidate", self._invalidate, qos_profile=qos.QUEUED_SERVICE)

    def phase_shutdown(self) -> None:
        """Close the store, unless a store operation hangs."""
        if self._worker is not None and self._worker.close() and self._store is not None:
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
            data = _told(request)
            return self.store.put(
                request.name,
                request.type,
                data,
                request.place,
                request.source,
                self._now_ns(),
                kind_hash=check_message(request.name, request.type, data),
                command=request.command,
            )

        try:
            if request.place:
                await self._require_place(request.place)
        except ImError as error:
            response.status = to_status(error)
            return response
        return await self._answer(response, put, changed=True)

    async def _append(self, request: AppendObject.Request, response: AppendObject.Response) -> AppendObject.Response:
        def append() -> ObjectRecord:
            more = _told(request)

            def extend(data: bytes) -> bytes:
                return extended(request.name, request.type, data, more)

            check_message(request.name, request.type, more)
            return self.store.append(
                request.name, request.type, extend, request.source, self._now_ns(), request=request.request
            )

        return await self._answer(response, append, changed=True)

    async def _require_place(self, place: str) -> None:
        """Check whether a place exists; wait for a net without a description so far.

        Raises:
            DataError: It is none by its form.
            NotFoundError: It does not.
        """
        deadline = clock.monotonic() + DESCRIBED_S
        while True:
            try:
                self._places.require(place)
                return
            except NotFoundError:
                left = deadline - clock.monotonic()
                if left <= 0.0 or len(self._undescribed) >= MOST_WAITING:
                    raise
            described = self.promise()
            self._undescribed.append(described)
            with suppress(WaitTimeoutError):
                await wait(self, described, left, f"the net of place {place} to be described")

    def _described(self, description: NetDescription) -> None:
        net = description.net
        stranger = net not in self._places
        self._places.describe(net, description.node, description.json)
        waiting, self._undescribed = self._undescribed, []
        for promise in waiting:
            if not promise.done():
                promise.set_result(None)
        self.spawn(self._abandon(net, self._places.of(net), DESCRIBED_S if stranger and not description.json else 0.0))

    async def _abandon(self, net: str, places: frozenset[str], wait_s: float) -> None:
        """Invalidate objects of places removed from a net: no token can refer to such objects.

        Args:
            net: Its name.
            places: Those that it has.
            wait_s: How long another node, which may have taken the net over, has to describe it [s].
        """

        def abandon() -> list[ObjectRecord]:
            return self.store.abandon(net, places, self.task_name, self._now_ns())

        if wait_s:
            await pause(self, wait_s)
        while self._places.of(net) == places:  # else it was described anew meanwhile
            try:
                for record in await self._ask(abandon):
                    self._tell(to_info(record))
                return
            except ImError as error:
                self.get_logger().error(f"objects of removed places of net {net} stay: {error.message}")
                await pause(self, ABANDON_AGAIN_S)

    def _get(
        self, request: GetObject.Request, response: GetObject.Response
    ) -> GetObject.Response | Coroutine[None, None, GetObject.Response]:
        """Answer at once from memory; else ask the store, and respond later."""
        cached = self.store.cached(request.name)
        if cached is None or request.version or request.as_json or not 0.0 <= request.timeout <= LONGEST_WAIT_S:
            return self._get_stored(request, response)
        record, data = cached
        if request.type not in ("", record.type):
            return self._get_stored(request, response)
        if not request.metadata_only:
            response.data = array("B", data)
        fill_info(response.object, record)
        response.success, response.status.code = True, OK
        return response

    async def _get_stored(self, request: GetObject.Request, response: GetObject.Response) -> GetObject.Response:
        def get() -> ObjectRecord:
            if request.metadata_only:
                return self.store.valid_record(request.name, request.version)
            record, data = self.store.get(request.name, request.type, request.version)
            if request.as_json:
                response.json = as_json(record.name, record.type, data)
            else:
                response.data = array("B", data)
            return record

        if not 0.0 <= request.timeout <= LONGEST_WAIT_S:
            text = f"the time-out {request.timeout:g} s is not allowed: 0 to {LONGEST_WAIT_S:g} s"
            response.status = to_status(DataError(text, timeout=request.timeout))
            return response
        deadline = clock.monotonic() + request.timeout
        while True:
            # before the look: no change in between is missed
            changed = self._next_change(request.name) if request.timeout else None
            try:
                await self._answer(response, get, changed=False)
                left = deadline - clock.monotonic()
                if changed is None or response.status.code not in NOT_VALID or left <= 0.0:
                    return response
                await wait(self, changed, left, f"data object '{request.name}' to be valid")
            except WaitTimeoutError:
                return response
            finally:
                if changed is not None:
                    self._awaited.pop(changed, None)

    def _next_change(self, name: str) -> Promise | None:
        """Return a promise of the next put of an object; None with too many waiting already."""
        if len(self._awaited) >= MOST_WAITING:
            return None
        promise = self.promise()
        self._awaited[promise] = name
        return promise

    async def _invalidate(
        self, request: InvalidateObject.Request, response: InvalidateObject.Response
    ) -> InvalidateObject.Response:
        if request.name.endswith("/"):
            return await self._forget(request, response)

        def invalidate() -> ObjectRecord:
            return self.store.invalidate(request.name, request.source, self._now_ns())

        return await self._answer(response, invalidate, changed=True)

    async def _forget(
        self, request: InvalidateObject.Request, response: InvalidateObject.Response
    ) -> InvalidateObject.Response:
        """Delete the objects of a command, or all below another name ending with ``/``."""

        def forget() -> list[ObjectRecord]:
            return self.store.forget(request.name)

        try:
            gone = await self._ask(forget)
        except ImError as error:
            response.success, response.status = False, to_status(error)
            return response
        for record in gone:
            self._tell(to_info(replace(record, source=request.source)))
        response.success, response.status, response.object.name = True, ok_status(), request.name
        self._mark(response.status)
        return response

    async def _list(self, request: ListObjects.Request, response: ListObjects.Response) -> ListObjects.Response:
        try:
            records = await self._ask(lambda: self.store.records(request.prefix))
        except ImError as error:
            response.success, response.status = False, to_status(error)
            return response
        response.objects = [to_info(record) for record in records]
        response.success, response.status = True, ok_status("; ".join(self.store.damages(request.prefix)))
        self._mark(response.status)
        return response

    async def _answer(self, response: AnswerT, operation: Callable[[], ObjectRecord], changed: bool) -> AnswerT:
        def late(record: ObjectRecord) -> None:  # who asked was told of a time-out; it has changed all the same
            if changed:
                self._tell(to_info(record))

        try:
            fill_info(response.object, await self._ask(operation, late))
        except ImError as error:
            if error.code == DAMAGED and error.message not in self._found_damaged:
                self._found_damaged.add(error.message)
                self._reminders.add("store", error.message)
            response.success, response.status = False, to_status(error)
            self._mark(response.status)
            return response
        response.success, response.status.code = True, OK
        self._mark(response.status)
        if changed:
            self._tell(response.object)
        return response

    def _ask(
        self, work: Callable[[], ResultT], late: Callable[[ResultT], None] = lambda _: None
    ) -> Coroutine[Any, Any, ResultT]:
        """Run work in the store, together with other waiting work; answered work is on the disk."""
        assert self._worker is not None, "the services are offered when the store is open"
        return self._worker.run(work, late)

    def _mark(self, status: Status) -> None:
        """Has an answer of the store tell its last transaction, by which clients notice an old copy of the store."""
        mark = str(self.store.mark)
        if self._last.value != mark:
            self._last = KeyValue(key=STORE_MARK, value=mark)
        status.facts.append(self._last)

    def _tell(self, info: ObjectInfo) -> None:
        self._change.object = info
        self._changes.publish(self._change)
        for promise in [promise for promise, name in self._awaited.items() if name == info.name]:
            if not promise.done():
                promise.set_result(None)

    def _now_ns(self) -> int:
        return int(self.get_clock().handle.get_now().nanoseconds)  # without an object of its time, which costs more


def _told(request: PutObject.Request | AppendObject.Request) -> bytes:
    """Return the message of a request, from one of the two forms.

    Raises:
        DataError: It says it in both, or its JSON does not fit the type.
        NotFoundError: Its type is not known.
    """
    if not request.json:
        return bytes(request.data)
    if request.data:
        raise DataError(f"data object '{request.name}' is given as data and JSON; give one", object=request.name)
    return from_json(request.name, request.type, request.json)


def to_info(record: ObjectRecord) -> ObjectInfo:
    """The message of a record."""
    info = ObjectInfo()
    fill_info(info, record)
    return info


def fill_info(info: ObjectInfo, record: ObjectRecord) -> None:
    """Has a message tell of a record."""
    info.name, info.type, info.type_hash = record.name, record.type, record.hash
    info.version, info.valid, info.size = record.version, record.valid, record.size
    info.place, info.source, info.command = record.place, record.source, record.command
    info.stamp.sec, info.stamp.nanosec = divmod(record.stamp_ns, 10**9)


def main() -> None:
    """Run ``/dom``."""
    sys.exit(run.main(DomNode))


if __name__ == "__main__":
    main()
