"""``truth_error``: ask the testbed for its truth and add the error of a calibration to its report."""

import argparse
import sys
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from im_bringup.calibration.summary import error_lines
from im_bringup.calibration.truth import add_to_report
from im_bringup.machine.interrupts import interrupt_once
from im_cell.robot.truth import CellTruth
from im_core.arrivals import read_json
from im_core.errors import ImError, StateError
from im_core.names import results_dir
from im_core.ros.calls import call_blocking
from im_core.ros.guard import GuardedNode
from im_core.ros.run import Spinner
from im_msgs.srv import GetTruth

TIMEOUT_S = 10.0


def get_truth(node: Node) -> CellTruth:
    """The truth of the testbed that runs.

    Raises:
        StateError: The testbed has none yet.
        WaitTimeoutError: It does not answer.
    """
    client = node.create_client(GetTruth, "/testbed/get_truth")
    answer = call_blocking(client, GetTruth.Request(), TIMEOUT_S, "true cameras")
    if not answer.success:
        raise StateError(answer.message)
    return read_json(CellTruth, answer.json, "the truth of the testbed")


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="truth_error", description="Add the true error to a calibration report.")
    parser.add_argument("report", type=Path, nargs="?", help="report.json (default: the latest)")
    arguments = parser.parse_args()
    path = arguments.report or results_dir() / "latest" / "report.json"
    interrupt_once()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = GuardedNode("truth_error")
    try:
        with Spinner([node]):
            report = add_to_report(path, get_truth(node))
    except ImError as error:
        print(f"truth_error: {error.message}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()
    print(error_lines(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
