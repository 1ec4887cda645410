"""Node of a Coordinator, with one net."""

from collections.abc import Callable

from im_coordinators.motion import check_told
from im_core.config import package_file
from im_core.ros import qos
from im_msgs.msg import McsState
from im_pnt.execution.functions import Functions
from im_pnt_analysis import verify_to_load
from im_pnt_node.rerun.host import Host
from im_pnt_node.ros.node import PntNode
from im_pnt_node.ros.node_host import NodeHost

MCS_STATE = "/mcs/state"


class Coordinator(PntNode):
    """Runs ``nets/<name>.yaml``.

    Attributes:
        host: The node, as its functions see it.
    """

    def __init__(self, name: str, make: Callable[[Host], Functions]) -> None:
        self.host = NodeHost()
        made, nets = make(self.host), [package_file("im_coordinators", f"nets/{name}.yaml")]
        made_by = f"{make.__module__}:{make.__name__}"
        super().__init__(name, nets, made.actions, made.guards, made.asks, verifier=verify_to_load, made_by=made_by)
        self.host.attach(self)

    def follow_mcs(self) -> None:
        """Follow the states told by MCS."""
        self.sources.follow(MCS_STATE, McsState, qos.LATCHED, check=lambda told: check_told(told.state, told.groups))
