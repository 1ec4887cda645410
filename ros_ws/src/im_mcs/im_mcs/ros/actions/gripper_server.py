"""``/<gripper>/gripper_cmd`` and that of a parallel gripper: open, close, grip with a force."""

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from control_msgs.action import GripperCommand, ParallelGripperCommand
from control_msgs.msg import GripperCommand as Opening
from numpy.typing import NDArray
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import JointState

from im_core.errors import DataError, ImError
from im_core.ros.messages.stamps import to_stamp
from im_mcs.ros.access import McsAccess
from im_mcs.ros.actions.motions import Goals, fail, require_wanted
from im_mcs.state import Event

_ACTIONS: dict[str, Any] = {
    "gripper_cmd": GripperCommand,
    "parallel_gripper_action_controller/gripper_cmd": ParallelGripperCommand,
}
"""Those of every gripper, by the name below the gripper's."""


class GripperServer:
    """The actions of both gripper controllers of ros2_control, for every gripper slot.

    Jaws that are held up on the way have gripped something: the goal succeeds, with ``stalled`` set. Those of a
    cancelled goal stop where they are; a new goal of either action takes the place of the one under way, which is
    aborted, as with a trajectory. The results have no room for a sentence; why a goal was refused is in the log and
    counted in ``/diagnostics``.
    """

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        self._names = [slot.name for slot in access.config.gripper_slots]
        self._moving: list[tuple[str, Any, ServerGoalHandle]] = []
        self._goals = Goals(access)
        for gripper in self._names:
            for name in _ACTIONS:
                self._goals.serve(_ACTIONS[name], f"/{gripper}/{name}", partial(self._execute, gripper, name))

    def publish_feedback(self, snapshot: NDArray[np.void]) -> None:
        """Publish the place of moving jaws."""
        for gripper, action, handle in self._moving:
            feedback = action.Feedback()
            self._fill(gripper, feedback, snapshot)
            handle.publish_feedback(feedback)

    async def _execute(self, gripper: str, name: str, handle: ServerGoalHandle) -> Any:
        action, command = _ACTIONS[name], handle.request.command
        result = action.Result()
        try:
            self._mcs.client()
            self._mcs.check(command)
            opening, force = _wanted(gripper, command)
            sender = await self._mcs.sender(self._goals.client(handle))
            arguments = {"gripper": gripper, "opening": opening, "force": force, "replaces": True, "sender": sender}
            require_wanted(handle)
            begin = partial(self._begin, gripper, action, handle)
            results = await self._mcs.request(Event.SET_GRIPPER, arguments, begin)
        except ImError as error:
            if error.code not in ("cancelled", "replaced"):
                self._mcs.refusals.add(f"/{gripper}/{name}", error)
            self._fill_present(gripper, result)
            fail(handle, error)
        else:
            self._fill_present(gripper, result)
            result.reached_goal = bool(results["reached"])
            result.stalled = not result.reached_goal
            handle.succeed()
        finally:
            self._goals.end_goal(handle)
            self._moving = [moving for moving in self._moving if moving[2] is not handle]
        return result

    def _begin(self, gripper: str, action: Any, handle: ServerGoalHandle, number: int) -> None:
        self._moving.append((gripper, action, handle))
        self._goals.begin_goal(handle, number)

    def _fill_present(self, gripper: str, message: Any) -> None:
        """Fill in place and force of the jaws, if known."""
        with suppress(ImError):
            self._fill(gripper, message, self._mcs.client().snapshot())

    def _fill(self, gripper: str, message: Any, snapshot: NDArray[np.void]) -> None:
        """Fill in opening [m] and force [N] of a snapshot, NaN where there is no sensor."""
        rank = self._names.index(gripper)
        opening, force = float(snapshot["gripper"][rank]), float(snapshot["gripper_force"][rank])
        if hasattr(message, "state"):
            message.state = JointState(name=[gripper], position=[opening], effort=[force])
            message.state.header.stamp = to_stamp(int(snapshot["stamp_ns"]))
        else:
            message.position, message.effort = opening, force


def _wanted(gripper: str, command: Opening | JointState) -> tuple[float, float]:
    """Return opening [m] and largest force [N], 0: all that there is, of a command.

    Raises:
        DataError: It is not of one joint, the gripper's.
    """
    if isinstance(command, Opening):
        return command.position, command.max_effort
    if list(command.name) not in ([], [gripper]):
        raise DataError(f"command.name is {list(command.name)}, not [] or ['{gripper}']", gripper=gripper)
    (opening,) = _numbers("position", command.position, (1,))
    return opening, sum(_numbers("effort", command.effort, (0, 1)), 0.0)


def _numbers(name: str, values: Sequence[float], counts: tuple[int, ...]) -> Sequence[float]:
    if len(values) not in counts:
        raise DataError(f"command.{name} has {len(values)} values, not {' or '.join(map(str, counts))}", field=name)
    return values
