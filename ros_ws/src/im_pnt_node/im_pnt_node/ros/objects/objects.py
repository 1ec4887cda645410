"""Data objects as read and stored by the expressions of nets."""

from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any

from im_core.errors import ImError
from im_core.ros.messages.interfaces import interface_class
from im_core.ros.messages.message_fields import filled
from im_pnt.execution.values import Done, ObjectPendingError
from im_pnt.expression.template import Way
from im_pnt_node.rerun.host import HostObjects
from im_pnt_node.ros.messages import plain_fields

Ways = tuple[Way, ...]


class _Reading:
    """Placeholder of an object during the reading."""


class DomObjects:
    """The objects of the Data Object Manager."""

    def __init__(
        self, dom: HostObjects, spawn: Callable[[Coroutine[object, object, None]], None], known: Callable[[], None]
    ) -> None:
        self._dom, self._spawn, self._known = dom, spawn, known
        self._latest: dict[tuple[str, Ways], dict[str, object] | ImError | _Reading] = {}

    async def read(self, name: str, kind: str, ways: Sequence[tuple[str, ...]]) -> dict[str, object]:
        """Return fields of an object as JSON data.

        Raises:
            ImError: There is none that is valid, it is of another type, or a field is no finite number.
        """
        message: Any = await self._dom.get(name, interface_class(kind))
        return plain_fields(message, ways, f"data object {name}")

    def latest(self, name: str, kind: str, ways: Sequence[Way]) -> dict[str, object]:
        """Return fields of an object, read since the last call of :meth:`stale`.

        Raises:
            ObjectPendingError: It is being read.
            ImError: As of :meth:`read`.
        """
        key = name, tuple(ways)
        if key not in self._latest:
            self._latest[key] = _Reading()
            self._spawn(self._look(key, kind, self._latest[key]))
        found = self._latest[key]
        if isinstance(found, _Reading):
            raise ObjectPendingError(f"data object {name} is being read", object=name)
        if isinstance(found, ImError):
            raise found
        return found

    def stale(self) -> None:
        """Has :meth:`latest` read objects anew."""
        self._latest = {}

    def forget(self, name: str) -> bool:
        """Read a changed object anew at the next use; return whether a guard needs the object."""
        gone = [key for key in self._latest if key[0] == name]
        for key in gone:
            del self._latest[key]
        return bool(gone)

    async def _look(self, key: tuple[str, Ways], kind: str, reading: object) -> None:
        found: dict[str, object] | ImError
        try:
            found = await self.read(key[0], kind, key[1])
        except ImError as error:
            found = error
        if self._latest.get(key) is reading:  # else it has changed meanwhile
            self._latest[key] = found
        self._known()

    async def put(self, name: str, kind: str, fields: Mapping[str, object], place: str = "") -> None:
        """Store an object.

        Raises:
            ImError: A field does not fit, or it was refused.
        """
        await self._dom.put(name, filled(interface_class(kind)(), fields, f"data object {name}"), place)

    def run(self, work: Coroutine[object, object, None], done: Done) -> None:
        """Run a coroutine; on failure, call back with the reason."""
        self._spawn(self._run(work, done))

    async def _run(self, work: Coroutine[object, object, None], done: Done) -> None:
        try:
            await work
        except ImError as error:
            done(error)
        else:
            done(None)
