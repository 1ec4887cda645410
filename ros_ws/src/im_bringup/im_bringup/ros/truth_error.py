"""``truth_error``: ask the testbed for the truth: the error of a calibration, added to its report, of arms, a place."""

import argparse
import sys
from pathlib import Path

from im_bringup.calibration.truth import add_to_report, arms_off, place_of, require_cell
from im_bringup.ros.client_output import DONE
from im_bringup.ros.interruptible import InterruptibleNode, talk
from im_cell.calibration_summary import error_lines
from im_cell.robot import load_cell
from im_cell.robot.truth import CellTruth
from im_core.errors import StateError
from im_core.names import results_dir
from im_core.text.bounded_json import read_json
from im_msgs.srv import GetTruth

SERVICE, TIMEOUT_S = "/testbed/get_truth", 10.0


def truth_in(answer: GetTruth.Response) -> CellTruth:
    """Extract the truth from the testbed's answer.

    Raises:
        StateError: The testbed has none yet.
    """
    if not answer.success:
        raise StateError(answer.message)
    return read_json(CellTruth, answer.json, "the truth of the testbed")


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="truth_error", description="Add the true error to a calibration report.")
    parser.add_argument("report", type=Path, nargs="?", help="report.json (default: the latest)")
    parser.add_argument("--object", metavar="NAME", help="tell where this free body is instead")
    parser.add_argument("--arm", action="store_true", help="tell how far the arms are off their drawing instead")
    arguments = parser.parse_args()
    path = arguments.report or results_dir() / "latest" / "report.json"

    def measure(node: InterruptibleNode) -> int:
        answer = node.ask(node.create_client(GetTruth, SERVICE), GetTruth.Request(), TIMEOUT_S)
        truth = truth_in(answer)
        if arguments.object:
            print(place_of(arguments.object, truth))
            return DONE
        require_cell(truth, cell := load_cell())
        print(arms_off(truth, cell) if arguments.arm else error_lines(add_to_report(path, truth, cell)))
        return DONE

    return talk(lambda: InterruptibleNode("truth_error"), measure, "truth_error")


if __name__ == "__main__":
    sys.exit(main())
