"""Action goals as actions of transitions.

The id of a goal follows from the incarnation of the process in which its activity began and the number of that, which
the journal brings back: a node that died asks the server about the goals that it had sent.
"""

import uuid
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_full_topic_name import validate_full_topic_name
from unique_identifier_msgs.msg import UUID

from im_core.errors import ConfigError, ImError, LinkError, StateError
from im_core.ros.calls import pause, wait
from im_core.ros.guard import GuardedActionClient
from im_core.ros.messages.interfaces import interface_class
from im_core.ros.peers.servers import doubted
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Activity
from im_pnt.model.action import Action, GoalAction
from im_pnt_node.ros.execution.actions import (
    RosActions,
    Surroundings,
    WatchedServer,
    answer_key,
    failure_of,
    handled,
    require_success,
    require_wanted,
    time_left,
)
from im_pnt_node.ros.messages import packed_message

ACCEPT_TIMEOUT_S = 30.0
GOAL_TIMEOUT_S = 600.0
CANCEL_TIMEOUT_S = 2.0
CANCEL_AGAIN_S = 0.2
ASK_S = 1.0

_NAMESPACE = uuid.UUID("6f0d9f4e-5f0c-4c7e-9a83-0c4ff1f1d0c1")
_OVER = (CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID, CancelGoal.Response.ERROR_GOAL_TERMINATED)


class GoalActions(RosActions[WatchedServer[ActionClient]]):
    """Client of goals: sends goals and waits for the results; a cancelled activity cancels the goal.

    Args:
        surroundings: Reaches other tasks.
        incarnation: Names the incarnation of the process.
        remap: New names of ROS actions, by the names in nets.
    """

    def __init__(self, surroundings: Surroundings, incarnation: Callable[[], str], remap: Mapping[str, str]) -> None:
        super().__init__(surroundings)
        self._incarnation, self._remap = incarnation, remap
        self._results: dict[Activity, Any] = {}
        self._performed: set[Activity] = set()

    def prepare(self, action: Action) -> WatchedServer[ActionClient]:
        """Return the client of an action, with the new name; errors as of :meth:`.RosActions.prepare`."""
        assert isinstance(action, GoalAction)
        return super().prepare(self._renamed(action))

    async def perform(self, activity: Activity, context: ActionContext) -> dict[str, object]:
        """Send a goal, wait for the result and handle the result; return the kept part.

        Raises:
            ImError: It was rejected, aborted or cancelled, or the server is gone.
        """
        self._performed.add(activity)
        try:
            return await self._perform(activity, context, chosen(activity, context))
        finally:
            self._performed.discard(activity)

    async def _perform(self, activity: Activity, context: ActionContext, action: GoalAction) -> dict[str, object]:
        around, server = self._surroundings, self.prepare(action)
        client, action = server.client, self._renamed(action)
        task = around.task(action)
        goal = await around.sent(activity, action, context, interface_class(action.type).Goal())

        async def reach() -> Any:
            there = f"the action {action.name}"
            await around.until_ready(server, action.name, task, there, lambda: activity.cancelled)
            require_wanted(activity, action)
            asked = f"an answer of {action.name} to the goal of transition {activity.transition}"
            accepting = client.send_goal_async(goal, goal_uuid=self._goal_id(activity))
            handle = await around.wait(accepting, task, ACCEPT_TIMEOUT_S, asked, server)
            # A server rejects a goal that it has already, of a former incarnation of this process that forgot it: that
            # counts.
            known = handle if handle.accepted else self._handle(client, activity)
            waited = f"the result of {action.name} (transition {activity.transition})"
            result = self._follow(activity, known)
            left = time_left(activity, GOAL_TIMEOUT_S)
            answer = await around.wait(result, task, left, waited, server)
            if answer.status == GoalStatus.STATUS_UNKNOWN:
                owner = task or "its server"
                if not handle.accepted:
                    rejected = StateError(f"{action} was rejected by {owner}", action=action.name)
                    raise doubted(around.node, rejected, action.name)
                forgot = "it was started again meanwhile, or nobody has asked for the result for too long"
                raise LinkError(f"{owner} does not know {action} any more: {forgot}", task=task, action=action.name)
            around.require_known_server(action.name, lambda: result_of(action, answer.status, answer.result))
            return answer

        answer = await around.log.read(answer_key(activity), reach(), packed_result)
        return await handled(around.functions, action, context, result_of(action, answer.status, answer.result))

    async def ask(self, activity: Activity, context: ActionContext) -> Answer:
        """Ask the server for the outcome of a goal from a former incarnation of the process."""
        around, action = self._surroundings, chosen(activity, context)
        server, action = self.prepare(action), self._renamed(action)
        if activity in self._performed:
            return Answer(Outcome.RUNNING, asked=f"{action.name}: its result is awaited")
        task = around.task(action)
        try:
            await around.until_ready(server, action.name, task, f"the action {action.name}")
            if activity not in self._results:
                self._results[activity] = self._follow(activity, self._handle(server.client, activity))
            result = self._results[activity]
            over = around.node.promise()  # a wait that is given up must not take the result with it
            result.add_done_callback(lambda _: over.set_result(None))
            await around.wait(over, task, ASK_S, f"what became of the goal of {action.name}", server)
        except ImError as error:
            if activity in self._results and error.code == "timeout":
                return Answer(Outcome.RUNNING, asked=error.message)
            if (result := self._results.pop(activity, None)) is not None:
                result.cancel()
            return Answer(Outcome.UNKNOWN, asked=error.message)
        del self._results[activity]
        answer = result.result()
        if answer.status == GoalStatus.STATUS_UNKNOWN:
            return Answer(Outcome.UNKNOWN, asked=f"{action.name} does not know the goal")
        try:
            kept = await handled(around.functions, action, context, result_of(action, answer.status, answer.result))
        except ImError as error:
            return Answer(Outcome.FAILED, error, asked=action.name)
        return Answer(Outcome.DONE, results=kept, asked=action.name)

    def _renamed(self, action: GoalAction) -> GoalAction:
        return replace(action, name=self._remap.get(action.name, action.name))

    def _follow(self, activity: Activity, handle: ClientGoalHandle) -> Any:
        """Begin to wait for a result, and cancel the goal with the activity."""
        result = handle.get_result_async()
        activity.when_cancelled(lambda: self._surroundings.node.spawn(self._cancel(handle, result)))
        return result

    async def _cancel(self, handle: ClientGoalHandle, result: Any) -> None:
        """Cancel a goal, again and again until the server confirms the end or winding down."""
        while not result.done():
            try:
                cancelling = handle.cancel_goal_async()
                response = await wait(self._surroundings.node, cancelling, CANCEL_TIMEOUT_S, "a cancellation")
            except ImError:
                continue
            if response.goals_canceling or response.return_code in _OVER:
                return
            await pause(self._surroundings.node, CANCEL_AGAIN_S)

    def _handle(self, client: ActionClient, activity: Activity) -> ClientGoalHandle:
        action = activity.action
        assert isinstance(action, GoalAction)
        accepted = interface_class(action.type).Impl.SendGoalService.Response(accepted=True)
        return ClientGoalHandle(client, self._goal_id(activity), accepted)

    def _goal_id(self, activity: Activity) -> UUID:
        begun = activity.begun_as or f"{self._incarnation()}/{activity.net}"
        return UUID(uuid=list(uuid.uuid5(_NAMESPACE, f"{begun}/{activity.number}").bytes))

    def _make(self, name: str, type_name: str) -> WatchedServer[ActionClient]:
        node = self._surroundings.node
        client = GuardedActionClient(node, interface_class(type_name), name)
        return WatchedServer(node, client, name, client.server_is_ready)

    def _destroy(self, endpoint: WatchedServer[ActionClient]) -> None:
        endpoint.stop()
        endpoint.client.destroy()


def chosen(activity: Activity, context: ActionContext) -> GoalAction:
    """Return the action of an activity with the name that its arguments choose."""
    action = activity.action
    assert isinstance(action, GoalAction)
    return replace(action, name=str(context.filled_now(action.name)))


def read_remap(text: str) -> dict[str, str]:
    """Return the new names of ROS actions, by the names in nets.

    Args:
        text: ``/old:=/new``, several with commas between; empty: none.

    Raises:
        ConfigError: It is something else, or gives a name twice.
    """
    names: dict[str, str] = {}
    for rule in filter(None, text.split(",")):
        old, _, new = rule.strip().partition(":=")
        try:
            validate_full_topic_name(old)
            validate_full_topic_name(new)
        except InvalidTopicNameException as error:
            raise ConfigError(f"remap {rule.strip()} is not of the form /old:=/new, full names of actions") from error
        if names.setdefault(old, new) != new:
            raise ConfigError(f"remap gives {old} two names, {names[old]} and {new}")
    return names


def packed_result(answer: Any) -> list[object]:
    """Return the answer to a goal as JSON data: status, type and CDR of the result."""
    return [int(answer.status), *packed_message(answer.result)]


def result_of(action: GoalAction, status: int, result: Any) -> Any:
    """Return the result of a successful goal.

    Raises:
        ImError: It has not: it was cancelled or aborted, or the result says so.
    """
    if status == GoalStatus.STATUS_CANCELED:
        raise failure_of(result, f"{action} was cancelled", "cancelled")
    if status != GoalStatus.STATUS_SUCCEEDED:
        raise failure_of(result, f"{action} was aborted", "aborted")
    require_success(result, str(action))
    return result
