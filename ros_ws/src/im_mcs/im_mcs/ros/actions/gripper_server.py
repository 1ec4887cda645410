"""``/<gripper>/gripper_cmd``: open, close, grip with a force."""

from contextlib import suppress
from functools import partial

import numpy as np
from control_msgs.action import GripperCommand
from numpy.typing import NDArray
from rclpy.action.server import ServerGoalHandle

from im_core.errors import ImError
from im_mcs.ros.access import McsAccess
from im_mcs.ros.actions.motions import Goals, fail, require_wanted
from im_mcs.state import Event


class GripperServer:
    """An action for every gripper slot.

    Jaws that are held up on the way have gripped something: the goal succeeds, with ``stalled`` set. Those of a
    cancelled goal stop where they are; a new goal takes the place of the one under way, which is aborted, as with a
    trajectory. The result of the action has no room for a sentence; why a goal was refused is in the log and counted in
    ``/diagnostics``.

    Args:
        access: MCS.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        self._names = [slot.name for slot in access.config.gripper_slots]
        self._moving: list[tuple[str, ServerGoalHandle]] = []
        self._goals = Goals(access)
        for gripper in self._names:
            self._goals.serve(GripperCommand, f"/{gripper}/gripper_cmd", partial(self._execute, gripper))

    def publish_feedback(self, snapshot: NDArray[np.void]) -> None:
        """Publish the place of moving jaws."""
        for gripper, handle in self._moving:
            opening, force = self._measured(gripper, snapshot)
            handle.publish_feedback(GripperCommand.Feedback(position=opening, effort=force))

    async def _execute(self, gripper: str, handle: ServerGoalHandle) -> GripperCommand.Result:
        command = handle.request.command
        result = GripperCommand.Result()
        try:
            self._mcs.client()
            self._mcs.check(command)
            wanted = {"opening": command.position, "force": command.max_effort}
            sender = await self._mcs.sender(self._goals.client(handle))
            arguments = {"gripper": gripper, **wanted, "replaces": True, "sender": sender}
            require_wanted(handle)
            results = await self._mcs.request(Event.SET_GRIPPER, arguments, partial(self._begin, gripper, handle))
        except ImError as error:
            if error.code not in ("cancelled", "replaced"):
                self._mcs.refusals.add(f"/{gripper}/gripper_cmd", error)
            self._fill(gripper, result)
            fail(handle, error)
        else:
            self._fill(gripper, result)
            result.reached_goal = bool(results["reached"])
            result.stalled = not result.reached_goal
            handle.succeed()
        finally:
            self._goals.end_goal(handle)
            self._moving = [(name, other) for name, other in self._moving if other is not handle]
        return result

    def _begin(self, gripper: str, handle: ServerGoalHandle, number: int) -> None:
        self._moving.append((gripper, handle))
        self._goals.begin_goal(handle, number)

    def _fill(self, gripper: str, result: GripperCommand.Result) -> None:
        """Fill in place and force of the jaws, if known."""
        with suppress(ImError):
            result.position, result.effort = self._measured(gripper, self._mcs.client().snapshot())

    def _measured(self, gripper: str, snapshot: NDArray[np.void]) -> tuple[float, float]:
        """Opening [m] and force [N], NaN where there is no sensor."""
        rank = self._names.index(gripper)
        return float(snapshot["gripper"][rank]), float(snapshot["gripper_force"][rank])
