"""Node ``/gripper_coordinator``."""

import sys

from im_coordinators.motion import require_working
from im_coordinators.ros.coordinator import MCS_STATE, Coordinator
from im_coordinators.ros.establishment import Establishment
from im_core.ros import run
from im_msgs.msg import McsState
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt_node.rerun.host import Host


class GripperCoordinator(Coordinator):
    """Run ``nets/gripper_coordinator.yaml``, with goals of MCS as actions."""

    def __init__(self) -> None:
        super().__init__("gripper_coordinator", gripper_functions)
        self.follow_mcs()


def gripper_functions(host: Host) -> Functions:
    """Return the functions of the net, for a node or a substitute."""
    powered = Establishment(host, "mcs", "powered")

    async def while_powered(ctx: ActionContext) -> dict[str, object]:
        """Return no extra arguments, while the arm still has the power established for the command.

        The result of a gripper's goal has no place for a reason: where MCS has stopped, no goal is sent.
        """
        gripper = str(ctx.request_arguments["gripper"])
        await powered.require(ctx, gripper.removesuffix("_gripper"))
        told: McsState | None = host.last(MCS_STATE)
        if told is not None:
            require_working(told.state, told.reason, gripper)
        return {}

    return Functions({"while_powered": while_powered})


def main() -> None:
    """Run ``/gripper_coordinator``."""
    sys.exit(run.main(GripperCoordinator))


if __name__ == "__main__":
    main()
