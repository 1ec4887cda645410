"""Client of the Data Object Manager."""

import contextlib
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from im_core.errors import WaitTimeoutError
from im_core.ros.calls import call
from im_core.ros.node import ManagedNode
from im_core.ros.status import status_to_error
from im_msgs.srv import GetObject, InvalidateObject, PutObject

#: Every request has the same effect however often it is made; one that met a server of a former life is made again.
TIMEOUT_S = 2.0
ATTEMPTS = 6


def type_name(message_type: type) -> str:
    """``geometry_msgs/msg/Pose`` for the class of that message."""
    package, kind = message_type.__module__.split(".")[:2]
    return f"{package}/{kind}/{message_type.__name__}"


class DomClient:
    """Puts and gets data objects (paper, section 6); every call is a coroutine.

    All raise ``WaitTimeoutError`` when ``/dom`` does not answer.
    """

    def __init__(self, node: ManagedNode) -> None:
        self._node = node
        self._put = node.create_client(PutObject, "/dom/put")
        self._get = node.create_client(GetObject, "/dom/get")
        self._invalidate = node.create_client(InvalidateObject, "/dom/invalidate")

    async def put(self, name: str, message: Any, place: str = "") -> int:
        """Store an object and make it valid; returns its version.

        Raises:
            ImError: It was refused.
        """
        request = PutObject.Request(
            name=name,
            type=type_name(type(message)),
            data=serialize_message(message),
            place=place,
            source=self._node.task_name,
        )
        answer = await self._ask(self._put, request, f"to store '{name}'")
        return int(answer.object.version)

    async def get(self, name: str, message_type: type) -> Any:
        """The object.

        Raises:
            ImError: There is none, it is not valid, or it is of another type.
        """
        request = GetObject.Request(name=name, type=type_name(message_type))
        answer = await self._ask(self._get, request, f"to read '{name}'")
        return deserialize_message(bytes(answer.data), message_type)

    async def is_valid(self, name: str) -> bool:
        """Whether there is a valid object of that name."""
        request = GetObject.Request(name=name, metadata_only=True)
        answer = await self._call(self._get, request, f"to look at '{name}'")
        return bool(answer.success)

    async def invalidate(self, name: str) -> None:
        """Declare an object invalid.

        Raises:
            ImError: There is none.
        """
        request = InvalidateObject.Request(name=name, source=self._node.task_name)
        await self._ask(self._invalidate, request, f"to invalidate '{name}'")

    async def _ask(self, client: Any, request: Any, what: str) -> Any:
        answer = await self._call(client, request, what)
        if not answer.success:
            raise status_to_error(answer.status)
        return answer

    async def _call(self, client: Any, request: Any, what: str) -> Any:
        for _ in range(ATTEMPTS - 1):
            with contextlib.suppress(WaitTimeoutError):
                return await call(self._node, client, request, TIMEOUT_S, what)
        return await call(self._node, client, request, TIMEOUT_S, what)
