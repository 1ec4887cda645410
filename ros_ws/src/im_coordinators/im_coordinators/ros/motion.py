"""Node ``/motion_coordinator``."""

import sys

from trajectory_msgs.msg import JointTrajectory

from im_coordinators.motion import HOLDING_STATES, POWERED_STATES, group_held, require_rest
from im_coordinators.ros.calibration import group_of
from im_core.config import package_file
from im_core.ros import qos, run
from im_msgs.msg import McsState
from im_msgs.srv import GetGroupState
from im_pnt.execution.functions import ActionContext, woken_by
from im_pnt.ros.node import PntNode
from im_pnt_analysis import verify_to_load

MCS_STATE = "/mcs/state"
of_mcs = woken_by(f"topic:{MCS_STATE}")


class MotionCoordinator(PntNode):
    """Functions and enabling functions of ``nets/motion_coordinator.yaml``; the net decides what comes when."""

    def __init__(self) -> None:
        super().__init__(
            "motion_coordinator",
            [package_file("im_coordinators", "nets/motion_coordinator.yaml")],
            functions={
                "group_to_reserve": self.group_to_reserve,
                "group_held": self.group_held,
                "path_to_follow": self.path_to_follow,
                "store_position": self.store_position,
            },
            guards={
                "mcs_powered": of_mcs(lambda _: self._mcs_state in POWERED_STATES),
                "mcs_in_motion": of_mcs(lambda _: self._mcs_state == "motion"),
                "right_held": of_mcs(lambda _: self._held == "right"),
                "mcs_holds_group": of_mcs(lambda _: self._mcs_state in HOLDING_STATES),
                "path_given": woken_by("data:given_path")(lambda _: self.sources.valid("given_path")),
            },
            verifier=verify_to_load,
        )
        self.sources.follow(MCS_STATE, McsState, qos.LATCHED)

    async def group_to_reserve(self, ctx: ActionContext) -> dict[str, object]:
        """The arm that is to move, for this node alone."""
        return {"group": await group_of(ctx, self.dom), "owner": self.get_fully_qualified_name()}

    async def group_held(self, ctx: ActionContext) -> dict[str, object]:
        """The arm that MCS holds."""
        return {"group": self._held}

    async def path_to_follow(self, ctx: ActionContext) -> dict[str, object]:
        """The goal of a move: the path in the DOM."""
        return {"path": await self.dom.get("path", JointTrajectory)}

    async def store_position(self, ctx: ActionContext, answer: GetGroupState.Response) -> None:
        """Stores the position that MCS measured at rest."""
        require_rest(answer.state.group, answer.state.at_rest)
        await self.dom.put("current_position", answer.state, place="motion_coordinator.pos_found")

    @property
    def _held(self) -> str:
        message = self._mcs
        return group_held([] if message is None else list(message.reserved_groups))

    @property
    def _mcs_state(self) -> str:
        message = self._mcs
        return "unconfigured" if message is None else str(message.state)

    @property
    def _mcs(self) -> McsState | None:
        message: McsState | None = self.sources.last(MCS_STATE)
        return message


def main() -> None:
    """Run ``/motion_coordinator``."""
    sys.exit(run.main(MotionCoordinator))


if __name__ == "__main__":
    main()
