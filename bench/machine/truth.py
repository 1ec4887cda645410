"""The truth of the testbed that runs, for those that measure against it."""

from rclpy.node import Node

from im_bringup.ros.truth_error import SERVICE, TIMEOUT_S, truth_in
from im_cell.robot.truth import CellTruth
from im_core.ros.calls import call_blocking
from im_msgs.srv import GetTruth


def get_truth(node: Node) -> CellTruth:
    """The truth of the testbed, asked by a node that spins.

    Raises:
        StateError: The testbed has none yet.
        WaitTimeoutError: It does not answer.
    """
    client = node.create_client(GetTruth, SERVICE)
    return truth_in(call_blocking(client, GetTruth.Request(), TIMEOUT_S, "true cameras"))
