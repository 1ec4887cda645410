"""Service calls and action goals as actions of transitions."""

import inspect
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.client import Client

from im_core.clock import monotonic
from im_core.errors import ImError, StateError
from im_core.ros.calls import call, pause, wait
from im_core.ros.heartbeats import Heartbeats
from im_core.ros.node import ManagedNode
from im_core.ros.status import status_to_error
from im_pnt.errors import NetError
from im_pnt.functions import ActionContext, Functions
from im_pnt.jobs import Activity
from im_pnt.net import GoalAction, ServiceAction
from im_pnt.ros.fields import fill, interface_class

SERVICE_TIMEOUT_S = 30.0
GOAL_TIMEOUT_S = 600.0
DISCOVERY_TIMEOUT_S = 6.0


class RosActions:
    """Carries out service calls and goals; every method raises an ImError where it fails.

    Args:
        node: The node.
        functions: Registered builders and handlers.
        heartbeats: Tells who is alive.
    """

    def __init__(self, node: ManagedNode, functions: Functions, heartbeats: Heartbeats) -> None:
        self._node = node
        self._functions = functions
        self._heartbeats = heartbeats
        self._services: dict[str, Client] = {}
        self._goals: dict[str, ActionClient] = {}

    def prepare(self, action: ServiceAction | GoalAction) -> None:
        """Makes the client of an action before it is needed: discovery takes time.

        Raises:
            NetError: No such interface.
        """
        if isinstance(action, ServiceAction):
            self._service_client(action)
        else:
            self._goal_client(action)

    async def perform_service(self, activity: Activity, context: ActionContext) -> None:
        """Calls a service; an answer with ``success`` false is a failure."""
        action = activity.action
        assert isinstance(action, ServiceAction)
        client = self._service_client(action)
        request = fill(client.srv_type.Request(), await self._fields(action, context), str(action))
        limit = _left(activity, SERVICE_TIMEOUT_S)
        task = self._task(action)
        what = f"transition {activity.transition}"
        if task is None:
            response = await call(self._node, client, request, limit, what)
        else:
            await self._until_ready(client.service_is_ready, task, f"the service {action.name} ({what})")
            future = client.call_async(request)
            response = await self._heartbeats.wait(future, task, limit, f"an answer of {action.name} ({what})")
        _require_success(response, str(action))
        await self._handled(action, context, response)

    async def perform_goal(self, activity: Activity, context: ActionContext) -> None:
        """Sends a goal and waits for its result; cancelling the activity cancels the goal."""
        action = activity.action
        assert isinstance(action, GoalAction)
        client = self._goal_client(action)
        goal = fill(interface_class(action.type).Goal(), await self._fields(action, context), str(action))
        task = self._task(action)
        await self._until_ready(client.server_is_ready, task, f"the action {action.name}")
        asked = f"an answer of {action.name} to the goal of transition {activity.transition}"
        handle = await self._wait(client.send_goal_async(goal), task, SERVICE_TIMEOUT_S, asked)
        if not handle.accepted:
            raise StateError(f"{action} was rejected", action=action.name)
        context.on_cancel(lambda: handle.cancel_goal_async())
        waited = f"the result of {action.name} (transition {activity.transition})"
        answer = await self._wait(handle.get_result_async(), task, _left(activity, GOAL_TIMEOUT_S), waited)
        if answer.status == GoalStatus.STATUS_CANCELED:
            raise _failure(answer.result, f"{action} was cancelled", "cancelled")
        if answer.status != GoalStatus.STATUS_SUCCEEDED:
            raise _failure(answer.result, f"{action} was aborted", "aborted")
        _require_success(answer.result, str(action))
        await self._handled(action, context, answer.result)

    async def _wait(self, future: Any, task: str | None, timeout_s: float, what: str) -> Any:
        if task is None:
            return await wait(self._node, future, timeout_s, what)
        return await self._heartbeats.wait(future, task, timeout_s, what)

    async def _until_ready(self, ready: Any, task: str | None, what: str) -> None:
        deadline = monotonic() + DISCOVERY_TIMEOUT_S
        since = self._heartbeats.incarnation(task) if task else None
        while not ready():
            missing = self._heartbeats.missing(task, since) if task else ""
            if missing or monotonic() > deadline:
                raise StateError(f"{what} is not there" + (f": {missing}" if missing else ""))
            await pause(self._node, 0.05)

    def _task(self, action: ServiceAction | GoalAction) -> str | None:
        """The task whose heartbeat is watched while an answer is awaited."""
        if action.task is not None:
            return action.task
        first = action.name.strip("/").partition("/")[0]
        return first if self._heartbeats.incarnation(first) is not None else None

    async def _fields(self, action: ServiceAction | GoalAction, context: ActionContext) -> dict[str, object]:
        built: object = {}
        if action.build:
            built = self._functions.actions[action.build](context)
            if inspect.isawaitable(built):
                built = await built
        if not isinstance(built, dict):
            raise NetError(f"builder {action.build} returned {built!r}, not a dict of fields")
        return {**action.fields, **built}

    async def _handled(self, action: ServiceAction | GoalAction, context: ActionContext, answer: Any) -> None:
        if action.handle:
            outcome = self._functions.actions[action.handle](context, answer)
            if inspect.isawaitable(outcome):
                await outcome

    def _service_client(self, action: ServiceAction) -> Client:
        if action.name not in self._services:
            self._services[action.name] = self._node.create_client(interface_class(action.type), action.name)
        return self._services[action.name]

    def _goal_client(self, action: GoalAction) -> ActionClient:
        if action.name not in self._goals:
            self._goals[action.name] = ActionClient(self._node, interface_class(action.type), action.name)
        return self._goals[action.name]


def _left(activity: Activity, default: float) -> float:
    """Time an activity has left, and a little more: the executive's own limit is to be the one that strikes [s]."""
    return default if activity.deadline is None else max(0.05, activity.deadline - monotonic()) + 1.0


def _require_success(answer: Any, what: str) -> None:
    if getattr(answer, "success", True) is False:
        raise _failure(answer, f"{what} did not succeed", "failed")


def _failure(answer: Any, otherwise: str, code: str) -> ImError:
    status = getattr(answer, "status", None)
    if status is not None and hasattr(status, "message") and status.message:
        return status_to_error(status)
    message = getattr(answer, "message", "") or getattr(answer, "error_string", "")
    return ImError(message or otherwise, code=code)
