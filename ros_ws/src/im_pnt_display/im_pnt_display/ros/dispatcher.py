"""Client of the Dispatcher and of MCS for the page: commands, the line, results, stops."""

import json
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from rclpy.client import Client
from rclpy.subscription import Subscription
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from im_core.errors import DataError, ImError, StateError
from im_core.names import results_dir
from im_core.ros import qos
from im_core.ros.calls import call, wait
from im_core.ros.guard import GuardedActionClient
from im_core.ros.node import ManagedNode
from im_core.text.bounded_json import read_json
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CommandState
from im_msgs.srv import ControlCommand, GroupCommand, ListCommands
from im_pnt_display.page.messages import result_pictures

ANSWER_S = 5.0
LOOK_S = 0.5
"""How often the line of commands is looked at while somebody views the page [s]."""
CONTROLS = ("cancel", "pause", "resume", "abandon")
STOPS = {"estop": "/mcs/estop", "protective_stop": "/mcs/protective_stop", "reset": "/mcs/reset"}

ShowPart = Callable[[str, object], None]
"""Shows a part of the state of commands, see :meth:`.DisplayState.commands`."""


class DispatcherClient:
    """Commands of the machine, followed while somebody views the page."""

    def __init__(self, node: ManagedNode, show: ShowPart) -> None:
        self._node, self._show = node, show
        self._known: Subscription | None = None
        self._clients: dict[str, Client] = {}
        self._execute = GuardedActionClient(node, ExecuteCommand, "/dispatcher/execute")
        self._looking = False
        self._timer = node.create_timer(LOOK_S, self._look, clock=node.steady_clock)
        self._timer.cancel()

    def follow(self, viewed: bool) -> None:
        """Begin to follow the commands, or end; in the loop of the node."""
        if viewed and self._known is None:
            self._timer.reset()
            self._known = self._node.create_subscription(String, "/dispatcher/commands", self._know, qos.LATCHED)
        elif self._known is not None and not viewed:
            self._timer.cancel()
            self._node.destroy_subscription(self._known)
            self._known = None

    async def do(self, request: str, argument: str) -> str:
        """Carry out the request of a viewer: start a command, control one, or stop the machine.

        Args:
            request: ``start``, a request of :data:`CONTROLS` or of :data:`STOPS`, or ``go_on`` after a protective stop.
            argument: JSON with ``symbol`` and ``arguments`` of a command to start, or with ``group`` and ``owner`` of
                what goes on; the number of a command to control.

        Returns:
            What was done.

        Raises:
            ImError: It was refused, or nobody answered.
        """
        if request == "start":
            return await self._start(read_json(dict[str, Any], argument, "a command"))
        if request in CONTROLS:
            if not (argument.isascii() and argument.isdecimal() and len(argument) < 10):
                raise DataError(f"{argument[:40]!r} is no number of a command")
            asked = ControlCommand.Request(command_id=int(argument), request=request)
            return await self._ask(ControlCommand, "/dispatcher/control_command", asked)
        if request == "go_on":
            stopped = read_json(dict[str, str], argument, "a group and its owner")
            wanted = GroupCommand.Request(group=stopped.get("group", ""), owner=stopped.get("owner", ""))
            return await self._ask(GroupCommand, "/mcs/resume", wanted)
        if request in STOPS:
            return await self._ask(Trigger, STOPS[request], Trigger.Request())
        known = ", ".join(("start", *CONTROLS, *STOPS, "go_on"))
        raise DataError(f"{request[:40]!r} is nothing that a machine can do; there are {known}")

    async def _ask(self, kind: Any, name: str, request: Any) -> str:
        answer = await call(self._node, self._client(kind, name), request, ANSWER_S, f"{name} of the page")
        if not answer.success:
            raise StateError(answer.message or f"{name} gave no reason")
        return answer.message or f"{name.removeprefix('/')} was done"

    async def _start(self, asked: dict[str, Any]) -> str:
        symbol = str(asked.get("symbol"))
        goal = ExecuteCommand.Goal(symbol=symbol, arguments=json.dumps(asked.get("arguments", {})))
        begun = self._node.promise()
        number: list[int] = []

        def told(message: Any) -> None:
            number[:] = [int(message.feedback.command_id)]
            if not begun.done():
                begun.set_result(None)

        def ended(future: Future) -> None:
            if not begun.done():
                outcome = future.result().result
                begun.set_result("" if outcome.success else outcome.status.message or "the dispatcher gave no reason")

        handle = await wait(
            self._node, self._execute.send_goal_async(goal, feedback_callback=told), ANSWER_S, f"command {symbol}"
        )
        if not handle.accepted:
            raise StateError(f"the dispatcher refused the command {symbol}")
        handle.get_result_async().add_done_callback(ended)
        if refusal := await wait(self._node, begun, ANSWER_S, f"the number of command {symbol}"):
            raise StateError(refusal)
        return f"{symbol} is command {number[0]}" if number else f"{symbol} is done"

    def _look(self) -> None:
        if not self._looking:  # the last look has been answered
            self._looking = True
            self._node.spawn(self._list())

    async def _list(self) -> None:
        try:
            client = self._client(ListCommands, "/dispatcher/list_commands")
            listed = await call(self._node, client, ListCommands.Request(), ANSWER_S, "the commands for the page")
        except ImError:  # the next look comes soon
            return
        finally:
            self._looking = False
        self._show(
            "listed",
            [
                {
                    **_heading(each),
                    "arguments": each.arguments,
                    "state": each.state,
                    "progress": round(float(each.progress), 3),
                    "needs": list(each.needs),
                }
                for each in listed.commands
            ],
        )
        self._show("ended", [_ended(each) for each in listed.ended])

    def _know(self, message: String) -> None:
        self._show("known", read_json(dict[str, Any], message.data, "/dispatcher/commands").get("commands", []))

    def _client(self, kind: Any, name: str) -> Client:
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        return self._clients[name]


def _ended(told: CommandState) -> dict[str, object]:
    results, pictures = _results(told.results)
    return {**_heading(told), "success": told.state == "done", "results": results, "pictures": pictures}


@lru_cache(maxsize=64)
def _results(text: str) -> tuple[dict[str, str], list[str]]:
    """Return results of an ended command and their pictures, read once: the list is looked at twice a second."""
    results = read_json(dict[str, str], text, "results")
    return results, result_pictures(results, results_dir())


def _heading(told: CommandState) -> dict[str, object]:
    return {"number": int(told.command_id), "symbol": told.symbol, "message": told.message}
