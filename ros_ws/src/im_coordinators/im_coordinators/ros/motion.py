"""Node ``/motion_coordinator``."""

import sys
from typing import Any

from im_core.config import package_file
from im_core.errors import LinkError, StateError
from im_core.ros import qos, run
from im_core.ros.calls import call, wait
from im_core.ros.status import status_to_error
from im_msgs.action import Move
from im_msgs.msg import GroupState, McsState, ObjectChange
from im_msgs.srv import GetGroupState
from im_pnt.ros.node import PntNode
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory

from im_coordinators.strategies import HOLDING_STATES, POWERED_STATES

GROUP = "left"
ANSWER_S = 5.0
LONGEST_MOVE_S = 240.0


class MotionCoordinator(PntNode):
    """Functions and enabling functions of ``nets/motion_coordinator.yaml``; the net decides what comes when."""

    def __init__(self) -> None:
        super().__init__(
            "motion_coordinator",
            [package_file("im_coordinators", "nets/motion_coordinator.yaml")],
            functions={"move_manip": self.move_manip, "find_pos": self.find_pos},
            guards={
                "mcs_cold": lambda _: self._mcs_state() == "cold",
                "mcs_powered": lambda _: self._mcs_state() in POWERED_STATES,
                "mcs_in_motion": lambda _: self._mcs_state() == "motion",
                "mcs_holds_group": lambda _: self._mcs_state() in HOLDING_STATES,
                "path_given": lambda _: self._path_given,
            },
        )
        self._state = McsState(state="unconfigured")
        self._path_given = False
        self.create_subscription(McsState, "/mcs/state", self._note_state, qos.LATCHED)
        self.create_subscription(ObjectChange, "/dom/changes", self._note_object, qos.EVENTS)
        self._group_state = self.create_client(GetGroupState, "/mcs/get_group_state")
        self._move = ActionClient(self, Move, f"/{GROUP}/move")

    async def move_manip(self, ctx: Any) -> None:
        """Has MCS follow the path in the DOM, and stores the position it ends at."""
        path = await self.dom.get("path", JointTrajectory)
        if not self._move.server_is_ready():
            raise LinkError(f"MCS offers no action /{GROUP}/move; is /mcs configured?")
        handle = await wait(self, self._move.send_goal_async(Move.Goal(path=path)), ANSWER_S, "MCS to accept a move")
        if not handle.accepted:
            raise StateError(f"MCS refused to move {GROUP}: it is {self._mcs_state()}", state=self._mcs_state())
        ctx.on_cancel(handle.cancel_goal_async)
        try:
            answer = await self.heartbeats.wait(
                handle.get_result_async(), "mcs", LONGEST_MOVE_S, f"the end of a move of {GROUP}"
            )
        except BaseException:
            handle.cancel_goal_async()
            raise
        if not answer.result.success:
            raise status_to_error(answer.result.status)
        await self.dom.put("current_position", answer.result.state)

    async def find_pos(self, ctx: Any) -> None:
        """Stores the position that MCS measured at rest."""
        state = await self._measured()
        if not state.at_rest:
            raise StateError(f"{GROUP} is not at rest; a position measured in motion is of no use", group=GROUP)
        await self.dom.put("current_position", state, place="motion_coordinator.pos_found")

    async def _measured(self) -> GroupState:
        request = GetGroupState.Request(group=GROUP)
        answer = await call(self, self._group_state, request, ANSWER_S, f"the position of {GROUP}")
        if not answer.success:
            raise status_to_error(answer.status)
        return answer.state

    def _mcs_state(self) -> str:
        return str(self._state.state)

    def _note_state(self, message: McsState) -> None:
        self._state = message

    def _note_object(self, message: ObjectChange) -> None:
        if message.object.name == "given_path":
            self._path_given = bool(message.object.valid)


def main() -> None:
    """Run ``/motion_coordinator``."""
    sys.exit(run.main(MotionCoordinator))


if __name__ == "__main__":
    main()
