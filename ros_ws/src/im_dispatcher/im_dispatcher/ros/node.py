"""Node ``/dispatcher``."""

import json
import sys
from collections.abc import Callable

from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle

from im_core.arrivals import read_json
from im_core.errors import ImError, StateError
from im_core.ros import run
from im_core.ros.calls import run_in_thread
from im_core.ros.guard import GuardedActionServer
from im_core.ros.status import to_status
from im_dispatcher.command import joined
from im_dispatcher.commands import calibrate_camera, installed
from im_dispatcher.ros.host import NodeHost
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CalibrationReport
from im_msgs.srv import CalibrateCamera, LoadNet
from im_pnt.netfile import load_net, parse_net
from im_pnt.ros.node import CommandOutcome, PntNode, ProgressListener
from im_pnt_analysis import verify_to_load

CANCEL_CHECK_S = 0.1

#: How long it may take to read a net [s].
READ_S = 60.0


class Dispatcher(PntNode):
    """Root of the Coordination Level: its services and its action write commands to the input tape of its nets."""

    def __init__(self) -> None:
        host, commands = NodeHost(), installed()
        functions = joined(command.functions(host) for command in commands)
        nets = [command.net for command in commands]
        super().__init__(
            "dispatcher", nets, functions.actions, functions.guards, functions.asks, verifier=verify_to_load
        )
        host.attach(self)
        self._standing = {symbol: tell for command in commands for symbol, tell in command.standing.items()}

    def phase_start(self) -> None:
        """Start the nets, then take commands."""
        super().phase_start()
        self.create_service(CalibrateCamera, "/dispatcher/calibrate_camera", self._calibrate_camera)
        self.create_service(LoadNet, "/dispatcher/load_net", self._load_net)
        self._execute_server = GuardedActionServer(
            self,
            ExecuteCommand,
            "/dispatcher/execute",
            self._execute,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    async def _run(
        self,
        symbol: str,
        arguments: dict[str, object],
        listener: ProgressListener | None = None,
        started: Callable[[int], None] | None = None,
    ) -> CommandOutcome:
        """Runs a command; refuses a second one of the same symbol."""
        running = self.commands.running(symbol)
        if running is not None:
            standing = self._standing[symbol](running) if symbol in self._standing else "begun"
            raise StateError(f"{symbol} is already running ({standing}); ask again when it has ended", command=symbol)
        return await self.command(symbol, arguments, listener, started)

    async def _calibrate_camera(
        self, request: CalibrateCamera.Request, response: CalibrateCamera.Response
    ) -> CalibrateCamera.Response:
        try:
            arguments: dict[str, object] = {"cameras": list(request.cameras), "poses_file": request.poses_file}
            outcome = await self._run(calibrate_camera.SYMBOL, arguments)
            response.success = outcome.success
            response.message = str(outcome.results.get("message", outcome.status.message))
            if outcome.success:
                response.report = await self.dom.get("calibration", CalibrationReport)
                response.report.json = json.dumps(outcome.results["report"])
                response.report.directory = str(outcome.results["directory"])
                response.message = response.report.message
        except ImError as error:
            response.success, response.message = False, error.message
        return response

    async def _execute(self, goal: ServerGoalHandle) -> ExecuteCommand.Result:
        result, feedback = ExecuteCommand.Result(), ExecuteCommand.Feedback()
        command_ids: list[int] = []

        def tell(step: str, message: str, progress: float) -> None:
            feedback.step, feedback.message = step or feedback.step, message
            feedback.progress = max(feedback.progress, progress)
            goal.publish_feedback(feedback)

        def check_cancel() -> None:
            if goal.is_cancel_requested and command_ids:
                self.cancel(command_ids.pop())

        timer = self.create_timer(CANCEL_CHECK_S, check_cancel, clock=self.steady_clock)
        try:
            symbol = goal.request.symbol
            if goal.request.attach:
                outcome = await self.commands.attach(symbol, tell, command_ids.append)
            else:
                arguments = _arguments(goal.request.arguments)
                outcome = await self._run(symbol, arguments, listener=tell, started=command_ids.append)
        except ImError as error:
            result.status = to_status(error)
            goal.abort()
            return result
        finally:
            self.destroy_timer(timer)
        result.success, result.status, result.results = outcome.success, outcome.status, json.dumps(outcome.results)
        if outcome.success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    async def _load_net(self, request: LoadNet.Request, response: LoadNet.Response) -> LoadNet.Response:
        try:
            read, told = (parse_net, request.net_yaml) if request.net_yaml else (load_net, request.net_file)
            net = await run_in_thread(self, read, told, timeout_s=READ_S)
            report = await self.load_net(net, request.wait)
        except ImError as error:
            response.success, response.message = False, error.message
            response.counterexample = [str(step) for step in getattr(error, "sequence", ())]
            return response
        response.success = True
        response.message = f"net {net.name} is live: {report.states} markings, bounded, never stuck"
        return response


def _arguments(text: str) -> dict[str, object]:
    """Arguments of a command, a JSON object or nothing.

    Raises:
        DataError: They are something else.
    """
    return read_json(dict[str, object], text or "{}", "the JSON object of the command's arguments")


def main() -> None:
    """Run ``/dispatcher``."""
    sys.exit(run.main(Dispatcher))


if __name__ == "__main__":
    main()
