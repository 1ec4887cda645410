"""Node ``/gripper_coordinator``."""

import sys

from im_coordinators.ros.establishment import Establishment
from im_core.config import package_file
from im_core.ros import run
from im_pnt.execution.functions import ActionContext
from im_pnt.ros.node import PntNode
from im_pnt_analysis import verify_to_load


class GripperCoordinator(PntNode):
    """Runs ``nets/gripper_coordinator.yaml``, whose actions are goals of MCS."""

    def __init__(self) -> None:
        nets = [package_file("im_coordinators", "nets/gripper_coordinator.yaml")]
        functions = {"while_powered": self.while_powered}
        super().__init__("gripper_coordinator", nets, functions, guards={}, verifier=verify_to_load)
        self._powered = Establishment(self, "mcs", "powered")

    async def while_powered(self, ctx: ActionContext) -> dict[str, object]:
        """Nothing but what the net says, while the arm has the power that it was given for the command."""
        await self._powered.require(ctx, str(ctx.request_arguments["gripper"]).removesuffix("_gripper"))
        return {}


def main() -> None:
    """Run ``/gripper_coordinator``."""
    sys.exit(run.main(GripperCoordinator))


if __name__ == "__main__":
    main()
