"""``truth_error``: ask the testbed for the truth and add the error of a calibration to the calibration's report."""

import argparse
import sys
from pathlib import Path

from im_bringup.calibration.truth import add_to_report
from im_bringup.ros.interruptible import DONE, InterruptibleNode, talk
from im_cell.calibration_summary import error_lines
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
    arguments = parser.parse_args()
    path = arguments.report or results_dir() / "latest" / "report.json"

    def measure(node: InterruptibleNode) -> int:
        answer = node.ask(node.create_client(GetTruth, SERVICE), GetTruth.Request(), TIMEOUT_S)
        print(error_lines(add_to_report(path, truth_in(answer))))
        return DONE

    return talk(lambda: InterruptibleNode("truth_error"), measure, "truth_error")


if __name__ == "__main__":
    sys.exit(main())
