"""Motions of groups on their way through the servo."""

from contextlib import suppress
from typing import TYPE_CHECKING, Any

from im_core.errors import ImError
from im_core.ros import qos
from im_mcs.client.servo_client import OnProgress
from im_mcs.ros import messages
from im_mcs.state import Event
from im_msgs.msg import GroupPath

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode, Started


class Motions:
    """Sends MOVE requests, shows the path that is followed, and stops what is under way.

    Args:
        node: The node that offers motions.
    """

    def __init__(self, node: "McsNode") -> None:
        self._node = node
        self._under_way: dict[int, str] = {}
        self._paths = {
            group: node.create_publisher(GroupPath, f"/{group}/path", qos.LATCHED) for group in node.group_names
        }

    async def run(
        self, arguments: dict[str, Any], started: "Started | None" = None, on_progress: OnProgress | None = None
    ) -> dict[str, Any]:
        """Move a group and await the end.

        Args:
            arguments: Of the MOVE request.
            started: Told the number of the request.
            on_progress: Told how far it is, in another thread.

        Raises:
            ImError: The motion is refused, or ended badly.
        """
        group = str(arguments["group"])
        shown: list[bool] = []
        numbers: list[int] = []

        def begin(number: int) -> None:
            numbers.append(number)
            self._under_way[number] = group
            if started is not None:
                started(number)

        def progress(*told: Any) -> None:
            with suppress(ImError):  # the servo may have ended since; then nobody needs to be told
                if not shown:
                    shown.append(True)
                    self._show(group, arguments["path"])
                if on_progress is not None:
                    on_progress(*told)

        try:
            return await self._node.request(Event.MOVE, arguments, begin, progress)
        finally:
            for number in numbers:
                self._under_way.pop(number, None)
            if shown:
                self._paths[group].publish(GroupPath())

    async def stop(self, group: str) -> None:
        """Let what a group does, and what waits for it, decelerate on its path and end as cancelled.

        Raises:
            ImError: The servo refuses.
        """
        numbers = [number for number, name in self._under_way.items() if name == group]
        for number in reversed(numbers):  # what waits first: it shall not begin
            try:
                await self._node.request(Event.CANCEL, {"goal": number})
            except ImError:
                if number in self._under_way:  # else it ended by itself meanwhile
                    raise

    def _show(self, group: str, path: dict[str, Any]) -> None:
        stamp_ns = int(self._node.client().snapshot()["stamp_ns"])
        self._paths[group].publish(messages.group_path(self._node.config.groups[group].joints, path, stamp_ns))
