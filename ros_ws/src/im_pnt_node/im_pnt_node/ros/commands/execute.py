"""Commands of a node's nets for all of ROS.

Action ``/<node>/execute`` runs one, topic ``/<node>/commands`` lists what there is, service ``/<node>/list_commands``
what is under way, and ``/<node>/control_command`` cancels, pauses, resumes and abandons it.
"""

import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from copy import copy

from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle
from std_msgs.msg import String

from im_core.errors import ArgumentError, ImError, NotFoundError, StateError
from im_core.ros import qos
from im_core.ros.guard import GuardedActionServer
from im_core.ros.messages.status import to_status
from im_core.ros.node import ManagedNode
from im_core.text.bounded_json import read_json
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CommandState
from im_msgs.srv import ControlCommand, ListCommands
from im_pnt.description import describe_commands
from im_pnt.execution.executor import Executor
from im_pnt.execution.token_values import shown_values
from im_pnt_node.journal.ended import EndedCommand
from im_pnt_node.ros.commands.commands import CommandOutcome, Commands, OpenCommand, ProgressListener

LOOK_S = 0.1

#: Commands that have ended, as told with those under way.
ENDED_TOLD = 10

#: Priorities that a client may add to what a command declares.
PRIORITIES = range(-10, 11)

REQUESTS = ("cancel", "pause", "resume", "abandon")


RunCommand = Callable[[str, dict[str, object], ProgressListener, Callable[[int], None], int], Awaitable[CommandOutcome]]
"""Runs a command to the end, as :meth:`.Commands.run`."""


class ExecuteServer:
    """Server of the action for commands: runs commands, reports progress, and controls the commands.

    Args:
        node: The node.
        nets: Its nets by name; looked at anew for each list.
        commands: Its commands.
        run: Runs a command.
        explained: Returns the resources of a command, and the resources still awaited.
        left_out: Why nets are not loaded: the cell lacks what they need; by the net's name.
    """

    def __init__(
        self,
        node: ManagedNode,
        nets: Mapping[str, Executor],
        commands: Commands,
        run: RunCommand,
        explained: Callable[[OpenCommand], tuple[Sequence[str], str]],
        left_out: Mapping[str, str],
    ) -> None:
        self._node, self._nets, self._commands, self._run, self._explained = node, nets, commands, run, explained
        self._left_out = left_out
        self._list = node.create_publisher(String, f"/{node.task_name}/commands", qos.LATCHED)
        self._server = GuardedActionServer(
            node,
            ExecuteCommand,
            f"/{node.task_name}/execute",
            self._execute,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        node.create_service(ListCommands, f"/{node.task_name}/list_commands", self._list_open)
        node.create_service(ControlCommand, f"/{node.task_name}/control_command", self._control_command, urgent=True)
        self._ended: dict[int, CommandState] = {}
        self.tell()

    def tell(self) -> None:
        """Publish the list of commands; call after a net has come or gone."""
        told = describe_commands((executor.written for executor in self._nets.values()), self._left_out)
        self._list.publish(String(data=json.dumps(told)))

    def _list_open(self, _: ListCommands.Request, response: ListCommands.Response) -> ListCommands.Response:
        response.commands = [self._state(command) for command in self._commands.open()]
        response.last = self._commands.last
        ended, told = self._commands.ended, self._ended
        self._ended = {n: told.get(n) or ended_state(ended[n]) for n in ended.newest(ENDED_TOLD)}
        response.ended = list(self._ended.values())
        return response

    def _state(self, command: OpenCommand) -> CommandState:
        asked = command.job.command
        needs, waits_for = self._explained(command)
        return CommandState(
            command_id=asked.id,
            symbol=asked.symbol,
            arguments=json.dumps(asked.arguments),
            state=command.state,
            priority=asked.priority,
            progress=command.progress,
            message=waits_for or command.text or command.step,
            needs=list(needs),
        )

    async def _control_command(
        self, request: ControlCommand.Request, response: ControlCommand.Response
    ) -> ControlCommand.Response:
        told = ""
        try:
            command = self._commands.get(request.command_id)
            match request.request:
                case "abandon":
                    told = f": {self._commands.abandon(request.command_id)}"
                case "cancel":
                    self._commands.cancel(request.command_id)
                case "pause" if not (command.held or command.job.cancelled):  # what is to end is not held up
                    self._commands.hold(request.command_id, True)
                case "resume" if command.held:
                    self._commands.hold(request.command_id, False)
                case "pause" | "resume" as wanted:
                    raise StateError(f"{command.job.command.symbol} is {command.state}: there is nothing to {wanted}")
                case other:
                    raise NotFoundError(kind="request to a command", name=other, known=REQUESTS)
        except ImError as error:
            response.success, response.message = False, error.message
            return response
        not_kept = await self._commands.on_file()
        response.success = True
        asked = f"{request.request} {command.job.command.symbol} (number {request.command_id})"
        response.message = f"{asked}{told}{not_kept}"
        return response

    async def _execute(self, goal: ServerGoalHandle) -> ExecuteCommand.Result:
        result, feedback = ExecuteCommand.Result(), ExecuteCommand.Feedback()
        numbers: list[int] = []
        waiting: list[ExecuteCommand.Feedback] | None = []  # who is told the number may count on the command

        def tell(step: str, message: str, progress: float) -> None:
            feedback.step, feedback.message = step or feedback.step, message
            feedback.progress = max(feedback.progress, progress)
            feedback.state = self._commands.get(feedback.command_id).state
            if waiting is None:
                goal.publish_feedback(feedback)
            else:
                waiting.append(copy(feedback))

        def tell_all() -> None:
            nonlocal waiting
            told, waiting = waiting or [], None
            for each in told:
                goal.publish_feedback(each)

        async def tell_when_written() -> None:
            await self._commands.written()
            tell_all()

        def started(number: int) -> None:
            numbers.append(number)
            feedback.command_id = number
            tell("", "", -1.0)
            self._node.spawn(tell_when_written())

        alarm = self._node.alarms.after(LOOK_S, lambda: look())

        def look() -> None:
            nonlocal alarm
            command = next((each for each in self._commands.open() if each.job.command.id in numbers), None)
            if goal.is_cancel_requested and numbers:
                self._commands.cancel(numbers[0])
                return
            if command is not None:
                waits_for = self._explained(command)[1]
                if command.state != feedback.state or waits_for not in ("", feedback.message):  # no firing tells that
                    tell("", waits_for or command.text, -1.0)
            alarm = self._node.alarms.after(LOOK_S, look)

        try:
            asked = goal.request
            if asked.attach:
                outcome = await self._commands.attach(asked.symbol, tell, started, asked.command_id)
            else:
                if asked.command_id:
                    text = f"command_id {asked.command_id} is that of a command to attach to; say attach, or leave it 0"
                    raise ArgumentError(text)
                if asked.priority not in PRIORITIES:
                    text = f"priority {asked.priority} is not between {PRIORITIES[0]} and {PRIORITIES[-1]}"
                    raise ArgumentError(text)
                outcome = await self._run(asked.symbol, read_arguments(asked.arguments), tell, started, asked.priority)
        except ImError as error:
            result.status = to_status(error)
            goal.abort()
            return result
        finally:
            self._node.alarms.cancel(alarm)
            tell_all()
        result.success, result.status, result.results = outcome.success, outcome.status, json.dumps(outcome.results)
        if outcome.success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result


def ended_state(ended: EndedCommand) -> CommandState:
    """Return the state of an ended command; reports among its results are told by their messages."""
    reports = [value for value in ended.results.values() if isinstance(value, Mapping)]
    told = [report["message"] for report in reports if isinstance(report.get("message"), str)]
    return CommandState(
        command_id=ended.number,
        symbol=ended.symbol,
        state="done" if ended.success else "failed",
        progress=1.0 if ended.success else -1.0,
        message=ended.message or "; ".join(told),
        results=json.dumps(shown_values(ended.results)),
    )


def read_arguments(text: str) -> dict[str, object]:
    """Read the arguments of a command, a JSON object or nothing.

    Raises:
        DataError: They are something else.
    """
    return read_json(dict[str, object], text or "{}", "the JSON object of the command's arguments")
