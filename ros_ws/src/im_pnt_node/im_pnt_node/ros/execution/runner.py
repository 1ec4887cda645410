"""Runner of the actions of a node's nets: functions, requests, and work of other tasks."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.exceptions import NameValidationException

from im_core.errors import FOREIGN, as_exception
from im_core.ros.calls import LONGEST_S, run_in_thread
from im_core.ros.coroutines import calling
from im_core.ros.heartbeats import Heartbeats
from im_core.ros.node import ManagedNode
from im_pnt.errors import NetError
from im_pnt.execution.apart import ApartContext
from im_pnt.execution.functions import ActionContext, ActionFunction, Functions
from im_pnt.execution.jobs import Activity
from im_pnt.execution.runner import FunctionRunner
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt.model.net import Net
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.rerun.log import MissionLog, NotedRequests, noted_answers
from im_pnt_node.ros.execution.actions import RosActions, ServiceActions, Surroundings, TopicActions
from im_pnt_node.ros.execution.awaits import AwaitActions
from im_pnt_node.ros.execution.endpoints import addressed
from im_pnt_node.ros.execution.goals import GoalActions
from im_pnt_node.ros.execution.loop import NetLoop


class NodeRunner(FunctionRunner):
    """Runner of actions in the loop of a node; a function of a user's module runs in a separate thread.

    Args:
        node: The node.
        functions: Registered functions.
        exchange: Carries requests.
        heartbeats: Tells who is alive.
        log: Is told what is sent, and what is answered.
        loop: Holds the journal, which keeps what builders leave in jobs.
        remap: New names of ROS actions, by the names in nets.

    Attributes:
        surroundings: Reach other tasks.
    """

    def __init__(
        self,
        node: ManagedNode,
        functions: Functions,
        exchange: Exchange,
        heartbeats: Heartbeats,
        log: MissionLog,
        loop: NetLoop,
        remap: Mapping[str, str],
    ) -> None:
        self._node, self._exchange, self._loop = node, exchange, loop
        self.surroundings = around = Surroundings(node, functions, heartbeats, log, self._keep)
        goals, awaits = GoalActions(around, lambda: exchange.book.incarnation, remap), AwaitActions(around)
        self._kinds: dict[type, RosActions[Any]] = {
            ServiceAction: ServiceActions(around),
            GoalAction: goals,
            TopicAction: TopicActions(around),
            AwaitAction: awaits,
        }
        super().__init__(
            functions,
            NotedRequests(exchange, log),
            node.spawn,
            {kind: actions.perform for kind, actions in self._kinds.items()},
            {GoalAction: noted_answers(goals.ask, log), AwaitAction: awaits.ask},
            apart=self._run_apart,
        )

    def prepare(self, net: Net) -> None:
        """Create the clients, publishers and subscriptions of the actions of a net.

        Raises:
            NetError: The middleware refuses one.
            NotFoundError: No such type is installed.
            EndpointGoesError: One is of another type, of a net that has gone, and goes now.
        """
        for transition in net.transitions.values():
            for action in addressed(net, transition):
                try:
                    self._kinds[type(action)].prepare(action)
                except (RuntimeError, ValueError, NameValidationException) as error:  # the middleware has its rules
                    why = " ".join(str(error).split())
                    text = f"{net.name}.{transition.name}: {action} cannot be prepared: {why}"
                    raise NetError(text, net=net.name, transition=transition.name) from error

    def _keep(self, activity: Activity) -> None:
        """Write what the builder of a request has left in the job to the journal, before the request leaves."""
        self._exchange.nets[activity.net].built(activity)
        if self._loop.journal is not None:
            self._loop.journal.write()

    async def _run_apart(self, function: ActionFunction, context: ActionContext) -> None:
        """Call a function in a separate thread, so the function may block."""

        def post(work: Callable[[], None]) -> None:
            self._node.spawn(calling(work))

        apart = ApartContext(context, post)
        outcome = await run_in_thread(self._node, _outcome_of, function, apart, tell_after_s=LONGEST_S)
        try:
            if isinstance(outcome, Exception):
                raise outcome
            if inspect.isawaitable(outcome):
                await outcome
        finally:
            apart.leave()


def _outcome_of(function: ActionFunction, context: ActionContext) -> object:
    """Return the result of a function, or the raised exception."""
    try:
        return function(context)
    except FOREIGN as error:  # it is foreign code: whatever it raises is its failure
        return as_exception(error)
