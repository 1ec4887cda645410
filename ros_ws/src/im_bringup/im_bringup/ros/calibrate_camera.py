"""``calibrate_camera``: the service call ``/dispatcher/calibrate_camera``, with progress from ``/pnt/firings``."""

import argparse
import json
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any, TextIO

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from im_bringup import machine
from im_bringup.progress import FiringPhase, ProgressLines
from im_bringup.summary import summary
from im_core import clock
from im_core.errors import ImError, LinkError, WaitTimeoutError
from im_core.ros import qos
from im_core.ros.node import STATUS_TOPIC
from im_core.ros.run import Spinner
from im_msgs.msg import Firing, TaskStatus
from im_msgs.srv import CalibrateCamera

SERVICE = "/dispatcher/calibrate_camera"
NET = "calibrate_camera"
#: Longest wait for the service to be found, and longest silence of the dispatcher [s] of wall time.
DISCOVERY_S = 10.0
SILENCE_S = 6.0

DONE, FAILED, BAD_USAGE, NOT_RUNNING, INTERRUPTED = 0, 1, 2, 3, 130


class Client(Node):
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
        self.create_subscription(Firing, "/pnt/firings", self._show, qos.EVENTS)
        self.create_subscription(TaskStatus, STATUS_TOPIC, self._hear, qos.STATUS)

    def interrupt(self) -> None:
        """Stop waiting; from a signal handler."""
        self._interrupted.set()

    def calibrate(self, cameras: list[str], poses_file: str) -> Any:
        """Call the service and wait for its answer.

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
            LinkError: The dispatcher fell silent or was started again; its answer will not come.
            WaitTimeoutError: There is no such service.
        """
        deadline = clock.monotonic() + DISCOVERY_S
        while not self._client.service_is_ready():
            self._pause()
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=f"the service {SERVICE}", seconds=DISCOVERY_S)
        self._lines = ProgressLines()
        future = self._client.call_async(CalibrateCamera.Request(cameras=cameras, poses_file=poses_file))
        self._heard, known = clock.monotonic(), self._incarnation
        while not future.done():
            self._pause()
            silent = clock.monotonic() - self._heard
            if silent > SILENCE_S:
                raise LinkError(f"the dispatcher is missing (last heard {silent:.1f} s ago)")
            known = known or self._incarnation
            if self._incarnation != known:
                raise LinkError("the dispatcher died and was started again; the command is lost")
        return future.result()

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


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="calibrate_camera", description="Calibrate cameras with the light on the arm."
    )
    parser.add_argument("--cameras", nargs="+", default=[], metavar="NAME", help="default: ceiling_left ceiling_right")
    parser.add_argument("--poses", type=Path, metavar="FILE", help="wrist poses (default: the cell's own)")
    parser.add_argument("--json", action="store_true", help="print the report as JSON; progress goes to stderr")
    arguments = parser.parse_args()
    poses = str(arguments.poses.resolve()) if arguments.poses else ""
    try:
        machine.read_running()
    except ImError as error:
        print(f"calibrate_camera: {error.message}", file=sys.stderr)
        return NOT_RUNNING
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    client = Client(sys.stderr if arguments.json else sys.stdout)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: client.interrupt())
    began = clock.monotonic()
    try:
        with Spinner([client]):
            response = client.calibrate(arguments.cameras, poses)
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
