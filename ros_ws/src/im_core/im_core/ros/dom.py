"""Client of the Data Object Manager."""

import uuid
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any, TypeVar

from rclpy.client import Client
from rclpy.serialization import serialize_message

from im_core import clock
from im_core.errors import DataError, ImError, WaitTimeoutError
from im_core.files import LARGEST, MEBIBYTE
from im_core.ros import qos
from im_core.ros.calls import ask_again, call
from im_core.ros.messages.interfaces import decoded, type_name
from im_core.ros.messages.status import status_to_error
from im_core.ros.node import ManagedNode
from im_core.ros.peers.servers import doubted
from im_core.store_mark import SeenStore, StoreMark
from im_msgs.msg import ObjectInfo
from im_msgs.srv import AppendObject, GetObject, InvalidateObject, ListObjects, PutObject

#: Objects of which a client remembers whether they are valid; more are asked for again.
MOST_KNOWN = 1000

#: Every request has the same effect however often it is made; one that met a former server is made again [s],
#: each time after twice as long, for an object may be large. A /dom that hangs is missed and started again within the
#: longer of these times.
TIMEOUT_S = 2.0
PATIENCE_S = 60.0

#: How long a MiB of an object may be on its way [s].
MEBIBYTE_S = 0.5

#: A request that waits for an object to be valid is made again after so long [s].
WAIT_S = 1.0

#: Kind of the error that says that an object was stored and is damaged in the store.
DAMAGED = "damaged"

#: Fact of an answer of the store that tells its last transaction (:class:`im_core.store_mark.StoreMark`).
STORE_MARK = "store_mark"

#: Kinds of errors that say that there is no valid object; all others, that nobody could look.
NOT_VALID = ("not_found", "state", DAMAGED)

#: No name of an object begins like this.
_NO_OBJECT = "/"

MessageT = TypeVar("MessageT")


@dataclass(frozen=True, slots=True)
class _Known:
    """Knowledge of an object: version, validity, and, if put by the present node, type and data."""

    version: int
    valid: bool
    own: tuple[type, bytes] | None = None


class DomClient:
    """Puts and gets data objects (paper, section 6); every call is a coroutine.

    What this node has put, and which objects are valid, is not asked for again until a change is heard of
    (:meth:`heard`) that says otherwise. What others have put is always asked for: a change may be heard of later than
    the token that it belongs to.

    All raise ``WaitTimeoutError`` when ``/dom`` does not answer.

    Attributes:
        damaged: Takes the sentence of each answer that says that an object is damaged in the store, or that the store
            has lost what was acknowledged.
        seen: The store as the answers tell of it.
    """

    def __init__(self, node: ManagedNode) -> None:
        self._node = node
        self.damaged: Callable[[str], None] = lambda text: None
        self.seen = SeenStore()
        self._known: dict[str, _Known] = {}
        self._put = node.create_client(PutObject, "/dom/put", qos_profile=qos.QUEUED_SERVICE)
        self._append = node.create_client(AppendObject, "/dom/append", qos_profile=qos.QUEUED_SERVICE)
        self._get = node.create_client(GetObject, "/dom/get", qos_profile=qos.QUEUED_SERVICE)
        self._invalidate = node.create_client(InvalidateObject, "/dom/invalidate", qos_profile=qos.QUEUED_SERVICE)
        self._list = node.create_client(ListObjects, "/dom/list", qos_profile=qos.QUEUED_SERVICE)

    def heard(self, info: ObjectInfo, own: tuple[type, bytes] | None = None) -> None:
        """Take the report of ``/dom`` on an object; the owner of a client passes on messages of ``/dom/changes``.

        Args:
            info: The versions of an object follow each other, and one that is not valid does not become so again.
            own: Type and data, if this node has put it.
        """
        known = self._known.get(info.name, _Known(0, True))
        newer, same = info.version > known.version, info.version == known.version
        if newer or (same and known.valid and (own is not None or not info.valid)):
            self._known.pop(info.name, None)
            self._known[info.name] = _Known(info.version, info.valid, own)
            if len(self._known) > MOST_KNOWN:
                del self._known[next(iter(self._known))]

    def forget_known(self) -> None:
        """Forget all known objects: ``/dom`` has died, and the changes reported meanwhile were missed."""
        self._known.clear()

    async def put(self, name: str, message: object, place: str = "", command: str = "") -> int:
        """Store an object as valid; the object outlives a power loss after the return.

        Args:
            name: Its name.
            message: A ROS message; at most 64 MiB of CDR.
            place: ``net.place`` that stands for it, or empty.
            command: Scope of the command that it is put for; empty: the one that its name begins with, if it does.

        Returns:
            Its version.

        Raises:
            ImError: It was refused.
        """
        data = serialize_message(message)
        if len(data) > LARGEST:
            text = f"data object '{name}' has {len(data)} bytes; at most {LARGEST} ({LARGEST // MEBIBYTE} MiB) are kept"
            raise DataError(text, object=name, size=len(data), allowed=LARGEST)
        request = PutObject.Request(
            name=name,
            type=type_name(type(message)),
            data=array("B", data),  # of bytes rclpy looks at each
            place=place,
            source=self._node.task_name,
            command=command,
        )
        answer = await self._ask(self._put, request, f"to store '{name}'", len(data))
        self.heard(answer.object, (type(message), data))
        return int(answer.object.version)

    async def append(self, name: str, message: object) -> int:
        """Append sequences of a message to the sequences of an object of the same type; other fields stay unchanged.

        It outlives the loss of power when this returns; place and command stay those for which the object was put.

        Args:
            name: Its name.
            message: What is appended, as a message of the object's type.

        Returns:
            The version that the object has then.

        Raises:
            ImError: There is none, it is not valid, or it was refused.
        """
        data = serialize_message(message)
        request = AppendObject.Request(
            name=name,
            type=type_name(type(message)),
            data=array("B", data),
            source=self._node.task_name,
            request=uuid.uuid4().hex,  # an answer may be lost, and the request be made again
        )
        answer = await self._ask(self._append, request, f"to append to '{name}'", len(data))
        self.heard(answer.object)
        return int(answer.object.version)

    async def get(self, name: str, message_type: type[MessageT], timeout_s: float = 0.0) -> MessageT:
        """The object.

        Args:
            name: Its name.
            message_type: Its type.
            timeout_s: Longest wait until it is valid, wall time [s].

        Raises:
            ImError: There is none, it is not valid, or it is of another type.
        """
        known = self._known.get(name)
        if known is not None and known.valid and known.own is not None and known.own[0] is message_type:
            data = known.own[1]
        else:
            answer = await self._when_valid(name, type_name(message_type), timeout_s)
            self.heard(answer.object)
            data = bytes(answer.data)
        message: MessageT = decoded(data, message_type)
        return message

    async def version(self, name: str, message_type: type[MessageT], version: int) -> MessageT:
        """Return a kept version of an object, possibly older than the newest.

        Raises:
            ImError: It is not kept, or is of another type.
        """
        request = GetObject.Request(name=name, type=type_name(message_type), version=version)
        answer = await self._ask(self._get, request, f"to read version {version} of '{name}'")
        message: MessageT = decoded(bytes(answer.data), message_type)
        return message

    async def _when_valid(self, name: str, kind: str, timeout_s: float) -> Any:
        """Return the answer with an object, once valid; the request is repeated now and then, for /dom may die."""
        deadline = clock.monotonic() + timeout_s
        while True:
            left = max(0.0, deadline - clock.monotonic())
            request = GetObject.Request(name=name, type=kind, timeout=min(left, WAIT_S))
            answer = await self._call(self._get, request, f"to read '{name}'")
            if answer.success:
                return answer
            if answer.status.code not in NOT_VALID or left <= WAIT_S:
                raise self._failure(self._get, answer)

    async def is_valid(self, name: str) -> bool:
        """Return whether a valid object of the name exists.

        An answer may be overtaken by a change, which arrives on another topic: what was heard meanwhile is newer.

        Raises:
            ImError: The store could not be read.
        """
        asked = self._known.get(name)
        if asked is not None and asked.valid:
            return True
        request = GetObject.Request(name=name, metadata_only=True)
        answer = await self._call(self._get, request, f"to look at '{name}'")
        if answer.success:
            self.heard(answer.object)
        elif answer.status.code not in NOT_VALID:
            raise self._failure(self._get, answer)
        known = self._known.get(name)
        if known is None or known is asked:
            return bool(answer.success)
        return known.valid

    async def invalidate(self, name: str) -> None:
        """Declare an object invalid.

        Raises:
            ImError: There is none.
        """
        request = InvalidateObject.Request(name=name, source=self._node.task_name)
        answer = await self._ask(self._invalidate, request, f"to invalidate '{name}'")
        self.heard(answer.object)

    def is_there(self) -> bool:
        """Whether ``/dom`` has been discovered."""
        return bool(self._list.service_is_ready() and self._invalidate.service_is_ready())

    async def names(self, prefix: str) -> list[str]:
        """Return the names of all objects beginning with ``prefix``, invalid objects included.

        Raises:
            ImError: The store could not be read.
        """
        answer = await self._ask(self._list, ListObjects.Request(prefix=prefix), f"to list '{prefix}'")
        return [str(info.name) for info in answer.objects]

    async def compare_store(self) -> None:
        """Ask for the last transaction of the store, if one is remembered: :attr:`damaged` is told of a loss.

        Raises:
            ImError: The store could not be read.
        """
        if self.seen.mark is not None:
            await self._ask(self._list, ListObjects.Request(prefix=_NO_OBJECT), "for the last transaction")

    async def forget(self, prefix: str) -> None:
        """Delete all objects below a name.

        Args:
            prefix: The name, and ``/``.

        Raises:
            ImError: It was refused.
        """
        request = InvalidateObject.Request(name=prefix, source=self._node.task_name)
        await self._ask(self._invalidate, request, f"to forget '{prefix}'")

    async def _ask(self, client: Client, request: object, what: str, size: int = 0) -> Any:
        answer = await self._call(client, request, what, size)
        if not answer.success:
            raise self._failure(client, answer)
        return answer

    def _failure(self, client: Client, answer: Any) -> ImError:
        return doubted(self._node, status_to_error(answer.status), client.srv_name)

    async def _call(self, client: Client, request: object, what: str, size: int = 0) -> Any:
        """Call a service, with a request of some size [bytes]."""
        before = self.seen.mark
        extra_s, tries = size // MEBIBYTE * MEBIBYTE_S, count()

        async def ask() -> Any:
            try:
                return await call(self._node, client, request, TIMEOUT_S * 2 ** next(tries) + extra_s, what)
            except WaitTimeoutError:
                self._known.clear()  # /dom may have died, and what it said while it came back is lost
                raise

        answer = await ask_again(ask, PATIENCE_S + extra_s, f"/dom {what}")
        marks = [fact.value for fact in answer.status.facts if fact.key == STORE_MARK]
        if marks:
            answer.status.facts = [fact for fact in answer.status.facts if fact.key != STORE_MARK]
            if lost := self.seen.see(StoreMark.of(marks[0]), before):
                self._known.clear()
                self.damaged(lost)
        if answer.status.code == DAMAGED:
            self.damaged(answer.status.message)
        return answer
