"""``calibrate_camera``: the service call ``/dispatcher/calibrate_camera``, with progress from ``/pnt/firings``.

A dispatcher that dies and is started again goes on with the command, but its answer has nobody to go to. This client
then attaches to the command with a goal of ``/dispatcher/execute``. While the machine runs, or is started again after
its bootstrap was killed, a silent dispatcher is waited for: only what is gone, or silent for long, is told as missing.
"""

import argparse
import json
import math
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

import rclpy
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions

from im_bringup.calibration.progress import FiringPhase, ProgressLines
from im_bringup.calibration.summary import summary
from im_bringup.machine import record as machine
from im_bringup.machine.record import MachineRecord
from im_core import clock
from im_core.errors import ImError, LinkError, WaitTimeoutError, require_text
from im_core.ros import qos
from im_core.ros.guard import GuardedActionClient, GuardedNode
from im_core.ros.run import Spinner
from im_core.startup import STATUS_TOPIC
from im_msgs.action import ExecuteCommand
from im_msgs.msg import Firing, TaskStatus
from im_msgs.srv import CalibrateCamera

SERVICE = "/dispatcher/calibrate_camera"
ACTION = "/dispatcher/execute"
NET = "calibrate_camera"
#: Longest wait for the service to be found, and longest silence of the dispatcher [s] of wall time: a dispatcher that
#: died is started again within a few seconds, on a busy computer later; one without a machine is not.
DISCOVERY_S = 10.0
SILENCE_S = 60.0
ALONE_S = 6.0
#: Time after which a goal that met the server of a former life is sent again [s].
ACCEPT_S = 2.0

DONE, FAILED, NOT_RUNNING, INTERRUPTED = 0, 1, 3, 130


class CalibrateCameraClient(GuardedNode):
    """Calls the service and prints the progress of the command.

    Args:
        progress: Where the progress goes; None: nowhere.
    """

    def __init__(self, progress: TextIO | None) -> None:
        super().__init__(f"calibrate_camera_{os.getpid()}")
        self._progress = progress
        self._lines = ProgressLines()
        self._heard = clock.monotonic()
        self._incarnation = 0
        self._interrupted = threading.Event()
        self._client = self.create_client(CalibrateCamera, SERVICE)
        self._attach: ActionClient = GuardedActionClient(self, ExecuteCommand, ACTION)
        self.create_subscription(Firing, "/pnt/firings", self._show, qos.EVENTS)
        self.create_subscription(TaskStatus, STATUS_TOPIC, self._hear, qos.STATUS)

    def interrupt(self) -> None:
        """Stop waiting; from a signal handler."""
        self._interrupted.set()

    def calibrate(self, cameras: list[str], poses_file: str) -> Any:
        """Call the service and wait for its answer, or for the end of the command if its dispatcher died meanwhile.

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
            LinkError: The dispatcher fell silent.
            WaitTimeoutError: There is no such service.
        """
        self._until(self._dispatcher_there, f"the service {SERVICE}")
        self._lines = ProgressLines()
        request = CalibrateCamera.Request(cameras=cameras, poses_file=poses_file)
        response = self._answer(self._client.call_async(request))
        if response is None:
            print("calibrate_camera: the dispatcher died and is back; waiting for the command to end", file=sys.stderr)
        while response is None:
            response = self._attached()
        return response

    def _dispatcher_there(self) -> bool:
        """Whether the dispatcher can be asked; one that was not heard before could die without being missed."""
        return bool(self._incarnation) and self._client.service_is_ready() and not _starting(machine.read())

    def _attached(self) -> Any | None:
        """The answer to the command that is running or ended last, None if the dispatcher died again."""
        self._until(self._attach.server_is_ready, f"the action {ACTION}")
        goal = ExecuteCommand.Goal(symbol=NET, attach=True)
        handle = self._answer(self._attach.send_goal_async(goal), ACCEPT_S)
        answer = None if handle is None else self._answer(handle.get_result_async())
        if answer is None:
            return None
        result, results = answer.result, json.loads(answer.result.results or "{}")
        message = str(results.get("message", result.status.message))
        response = CalibrateCamera.Response(success=result.success, message=message)
        if result.success:
            response.message = str(results["report"]["message"])
            response.report.json, response.report.directory = json.dumps(results["report"]), results["directory"]
        return response

    def _answer(self, future: Any, limit_s: float = math.inf) -> Any | None:
        """The result of a future that the dispatcher completes, None if it was started again or does not in time."""
        begun, known = clock.monotonic(), self._incarnation
        self._heard = begun
        while not future.done():
            self._pause()
            if clock.monotonic() - begun > limit_s:
                return None
            silent = clock.monotonic() - self._heard
            if silent > ALONE_S and (why := _why_lost(silent)):
                raise LinkError(f"the dispatcher is missing (last heard {silent:.1f} s ago){why}")
            if self._incarnation != known:
                return None
        return future.result()

    def _until(self, ready: Callable[[], bool], what: str) -> None:
        deadline = clock.monotonic() + DISCOVERY_S
        while not ready():
            self._pause()
            if clock.monotonic() > deadline and not _starting(machine.read()):
                raise WaitTimeoutError(what=what, seconds=DISCOVERY_S)

    def _pause(self) -> None:
        if self._interrupted.wait(0.02):
            raise KeyboardInterrupt

    def _hear(self, message: TaskStatus) -> None:
        if message.name == "dispatcher":
            self._heard, self._incarnation = clock.monotonic(), message.incarnation

    def _show(self, message: Firing) -> None:
        if message.net != NET or self._progress is None:
            return
        line = self._lines.line(
            message.transition, FiringPhase(message.phase), message.message, message.progress, message.duration
        )
        if line is not None:
            print(line, file=self._progress, flush=True)


def _starting(record: MachineRecord | None) -> bool:
    """Whether the machine is being started, perhaps again."""
    return record is not None and record.alive and record.state == machine.STARTING


def _why_lost(silent_s: float) -> str:
    """Why a dispatcher that has been silent for so long will not answer, a clause; empty if it may yet."""
    record = machine.read()
    if record is None or not record.alive:
        return ": the machine has ended, its bootstrap is gone"
    return "" if silent_s <= SILENCE_S or _starting(record) else f"; the machine is {record.state}"


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
    try:
        machine.read_running()
    except ImError as error:
        print(f"calibrate_camera: {error.message}", file=sys.stderr)
        return NOT_RUNNING
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    client = CalibrateCameraClient(sys.stderr if arguments.json else sys.stdout)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: client.interrupt())
    began = clock.monotonic()
    try:
        with Spinner([client]):
            response = client.calibrate(cameras, poses)
    except KeyboardInterrupt:
        print("calibrate_camera: no longer waiting; the machine goes on with the command", file=sys.stderr)
        return INTERRUPTED
    except ImError as error:
        print(f"calibrate_camera: {error.message}", file=sys.stderr)
        return NOT_RUNNING if isinstance(error, WaitTimeoutError) else FAILED
    finally:
        rclpy.try_shutdown()
    return show(response, arguments.json, clock.monotonic() - began)


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
