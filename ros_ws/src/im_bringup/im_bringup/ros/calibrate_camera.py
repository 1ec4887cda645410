"""``calibrate_camera``: the service call ``/dispatcher/calibrate_camera``, with progress from ``/pnt/firings``.

A dispatcher that dies and is started again goes on with the command, but its answer has nobody to go to; that of one
which was silent for long may be lost. This client then attaches to the command with a goal of ``/dispatcher/execute``.
While the machine runs, or is started again after its bootstrap was killed, a silent dispatcher is waited for: only what
is gone, or silent for long, is told as missing.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, TextIO

from rclpy.action import ActionClient

from im_bringup.calibration.progress import FiringPhase, ProgressLines
from im_bringup.calibration.summary import summary
from im_bringup.ros.dispatcher import ACCEPT_S, ACTION, GOES_ON, SILENCE_S, DispatcherClient
from im_bringup.ros.interruptible import DONE, FAILED, talk
from im_core import clock
from im_core.errors import ImError, require_text
from im_core.ros import qos
from im_core.ros.guard import GuardedActionClient
from im_core.ros.servers import reason
from im_msgs.action import ExecuteCommand
from im_msgs.msg import Firing
from im_msgs.srv import CalibrateCamera

SERVICE = "/dispatcher/calibrate_camera"
NET = "calibrate_camera"
_PHASES = {int(phase): phase for phase in FiringPhase}


class CalibrateCameraClient(DispatcherClient):
    """Calls the service and prints the progress of the command.

    Args:
        progress: Where the progress goes; None: nowhere.
    """

    def __init__(self, progress: TextIO | None) -> None:
        super().__init__("calibrate_camera")
        self._progress = progress
        self._lines = ProgressLines()
        self._client = self.create_client(CalibrateCamera, SERVICE)
        self._attach: ActionClient = GuardedActionClient(self, ExecuteCommand, ACTION)
        self.create_subscription(Firing, "/pnt/firings", self._show, qos.EVENTS)

    def calibrate(self, cameras: list[str], poses_file: str) -> Any:
        """Call the service and wait for its answer, or for the end of the command if its dispatcher was away meanwhile.

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
            LinkError: The dispatcher fell silent.
            StateError: It died before it had written the command down, or which one it is is not known.
            WaitTimeoutError: There is no such service.
        """
        self._until(self._dispatcher_there, f"the service {SERVICE}")
        self._lines = ProgressLines()
        before = self.moment()
        request = CalibrateCamera.Request(cameras=cameras, poses_file=poses_file)
        response = self._answer(self._client.call_async(request), asked_once=True)
        if response is not None and not response.success:
            response.message = reason(self, response.message, SERVICE)
        if response is None:
            print("calibrate_camera: the dispatcher was away and is back; waiting for the command", file=sys.stderr)
            number = self.begun_since(before, NET)  # not the last one that has ended: that may be of another day
        while response is None:
            response = self._attached(number)
        return response

    def _dispatcher_there(self) -> bool:
        """Whether the service can be called."""
        return super()._dispatcher_there() and self._client.service_is_ready()

    def _attached(self, number: int) -> Any | None:
        """The answer to a command that is running or has ended, None if the dispatcher died again."""
        self._until(self._attach.server_is_ready, f"the action {ACTION}", SILENCE_S)
        goal = ExecuteCommand.Goal(symbol=NET, attach=True, command_id=number)
        handle = self._answer(self._attach.send_goal_async(goal), ACCEPT_S)
        result = None if handle is None else self._result(self._answer(handle.get_result_async()))
        if result is None:
            return None
        results = json.loads(result.results or "{}")
        message = str(results.get("message") or result.status.message)
        response = CalibrateCamera.Response(success=result.success, message=message)
        if result.success:
            response.message = str(results["report"]["message"])
            response.report.json, response.report.directory = json.dumps(results["report"]), results["directory"]
        return response

    def _show(self, message: Firing) -> None:
        phase = _PHASES.get(message.phase)  # of a stranger's message the user need not hear
        if message.net != NET or self._progress is None or phase is None:
            return
        line = self._lines.line(message.transition, phase, message.message, message.progress, message.duration)
        if line is not None:
            print(line, file=self._progress, flush=True)


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="calibrate_camera", description="Calibrate cameras with the light on the arm."
    )
    parser.add_argument("--cameras", nargs="+", default=[], metavar="NAME", help="default: ceiling_left ceiling_right")
    parser.add_argument("--poses", type=Path, metavar="FILE", help="wrist poses (default: the cell's own)")
    parser.add_argument("--json", action="store_true", help="print the report as JSON; progress goes to stderr")
    arguments = parser.parse_args()
    try:
        poses = require_text(str(arguments.poses.resolve()), "--poses") if arguments.poses else ""
        cameras = [require_text(name, "--cameras") for name in arguments.cameras]
    except ImError as error:
        parser.error(error.message)

    def make() -> CalibrateCameraClient:
        return CalibrateCameraClient(sys.stderr if arguments.json else sys.stdout)

    def calibrate(client: CalibrateCameraClient) -> int:
        began = clock.monotonic()
        response = client.calibrate(cameras, poses)
        return show(response, arguments.json, clock.monotonic() - began)

    return talk(make, calibrate, "calibrate_camera", GOES_ON)


def show(response: Any, as_json: bool, seconds: float) -> int:
    """Print the answer; returns the exit code."""
    if not response.success:
        print(f"calibrate_camera: {response.message}", file=sys.stderr)
        return FAILED
    report = json.loads(response.report.json)
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        print(f"\ncalibrate_camera: done in {seconds:.1f} s: {response.message}")
        print(summary(report))
        print(f"report and pictures: {response.report.directory}")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
