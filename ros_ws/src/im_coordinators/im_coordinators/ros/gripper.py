"""Node ``/gripper_coordinator``."""

import sys

from im_coordinators.ros.establishment import Establishment
from im_core.config import package_file
from im_core.ros import run
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt_analysis import verify_to_load
from im_pnt_node.rerun.host import Host
from im_pnt_node.ros.node import PntNode
from im_pnt_node.ros.node_host import NodeHost


class GripperCoordinator(PntNode):
    """Run ``nets/gripper_coordinator.yaml``, with goals of MCS as actions."""

    def __init__(self) -> None:
        host = NodeHost()
        made, nets = gripper_functions(host), [package_file("im_coordinators", "nets/gripper_coordinator.yaml")]
        name, made_by = "gripper_coordinator", f"{__name__}:{gripper_functions.__name__}"
        super().__init__(name, nets, made.actions, made.guards, made.asks, verifier=verify_to_load, made_by=made_by)
        host.attach(self)


def gripper_functions(host: Host) -> Functions:
    """Return the functions of the net, for a node or a substitute."""
    powered = Establishment(host, "mcs", "powered")

    async def while_powered(ctx: ActionContext) -> dict[str, object]:
        """Return no extra arguments, while the arm still has the power established for the command."""
        await powered.require(ctx, str(ctx.request_arguments["gripper"]).removesuffix("_gripper"))
        return {}

    return Functions({"while_powered": while_powered})


def main() -> None:
    """Run ``/gripper_coordinator``."""
    sys.exit(run.main(GripperCoordinator))


if __name__ == "__main__":
    main()
