"""Client of the Data Object Manager."""

from dataclasses import dataclass
from typing import Any, TypeVar

from rclpy.client import Client
from rclpy.serialization import deserialize_message, serialize_message

from im_core.errors import WaitTimeoutError
from im_core.ros.calls import call
from im_core.ros.interfaces import type_name
from im_core.ros.node import ManagedNode
from im_core.ros.status import status_to_error
from im_msgs.msg import ObjectInfo
from im_msgs.srv import GetObject, InvalidateObject, PutObject

#: Every request has the same effect however often it is made; one that met a server of a former life is made again.
TIMEOUT_S = 2.0
ATTEMPTS = 6

MessageT = TypeVar("MessageT")


@dataclass(frozen=True, slots=True)
class _Known:
    """What is known of an object: its version, whether that is valid, and type and data if this node has put it."""

    version: int
    valid: bool
    own: tuple[type, bytes] | None = None


class DomClient:
    """Puts and gets data objects (paper, section 6); every call is a coroutine.

    What this node has put, and which objects are valid, is not asked for again until a change is heard of
    (:meth:`heard`) that says otherwise. What others have put is always asked for: a change may be heard of later than
    the token that it belongs to.

    All raise ``WaitTimeoutError`` when ``/dom`` does not answer.
    """

    def __init__(self, node: ManagedNode) -> None:
        self._node = node
        self._known: dict[str, _Known] = {}
        self._put = node.create_client(PutObject, "/dom/put")
        self._get = node.create_client(GetObject, "/dom/get")
        self._invalidate = node.create_client(InvalidateObject, "/dom/invalidate")

    def heard(self, info: ObjectInfo, own: tuple[type, bytes] | None = None) -> None:
        """Takes what ``/dom`` says of an object; whoever has a client hands on what arrives on ``/dom/changes``.

        Args:
            info: The versions of an object follow each other, and one that is not valid does not become so again.
            own: Type and data, if this node has put it.
        """
        known = self._known.get(info.name, _Known(0, True))
        newer, same = info.version > known.version, info.version == known.version
        if newer or (same and known.valid and (own is not None or not info.valid)):
            self._known[info.name] = _Known(info.version, info.valid, own)

    async def put(self, name: str, message: object, place: str = "") -> int:
        """Store an object and make it valid; returns its version.

        Raises:
            ImError: It was refused.
        """
        data = serialize_message(message)
        request = PutObject.Request(
            name=name, type=type_name(type(message)), data=data, place=place, source=self._node.task_name
        )
        answer = await self._ask(self._put, request, f"to store '{name}'")
        self.heard(answer.object, (type(message), data))
        return int(answer.object.version)

    async def get(self, name: str, message_type: type[MessageT]) -> MessageT:
        """The object.

        Raises:
            ImError: There is none, it is not valid, or it is of another type.
        """
        known = self._known.get(name)
        if known is not None and known.valid and known.own is not None and known.own[0] is message_type:
            data = known.own[1]
        else:
            request = GetObject.Request(name=name, type=type_name(message_type))
            answer = await self._ask(self._get, request, f"to read '{name}'")
            self.heard(answer.object)
            data = bytes(answer.data)
        message: MessageT = deserialize_message(data, message_type)
        return message

    async def is_valid(self, name: str) -> bool:
        """Whether there is a valid object of that name."""
        known = self._known.get(name)
        if known is not None and known.valid:
            return True
        request = GetObject.Request(name=name, metadata_only=True)
        answer = await self._call(self._get, request, f"to look at '{name}'")
        if answer.success:
            self.heard(answer.object)
        return bool(answer.success)

    async def invalidate(self, name: str) -> None:
        """Declare an object invalid.

        Raises:
            ImError: There is none.
        """
        request = InvalidateObject.Request(name=name, source=self._node.task_name)
        answer = await self._ask(self._invalidate, request, f"to invalidate '{name}'")
        self.heard(answer.object)

    async def _ask(self, client: Client, request: object, what: str) -> Any:
        answer = await self._call(client, request, what)
        if not answer.success:
            raise status_to_error(answer.status)
        return answer

    async def _call(self, client: Client, request: object, what: str) -> Any:
        for _ in range(ATTEMPTS - 1):
            try:
                return await call(self._node, client, request, TIMEOUT_S, what)
            except WaitTimeoutError:
                self._known.clear()  # /dom may have died, and what it said while it came back is lost
        return await call(self._node, client, request, TIMEOUT_S, what)
