"""What service calls, action goals and publications of transitions have in common."""

import inspect
from collections.abc import Callable
from typing import Any, Protocol

from im_core.clock import monotonic
from im_core.errors import ImError, StateError
from im_core.ros.calls import pause, wait
from im_core.ros.heartbeats import Heartbeats
from im_core.ros.node import ManagedNode
from im_core.ros.status import status_to_error
from im_pnt.action import Action, GoalAction, ServiceAction, TopicAction
from im_pnt.errors import NetError
from im_pnt.functions import ActionContext, Functions
from im_pnt.jobs import Activity

DISCOVERY_TIMEOUT_S = 6.0
SETTLING_S = 1.0
"""Time in which a client and its server have certainly discovered each other, both ways [s]."""
LATE_ANSWER_S = 30.0


class RosAction(Protocol):
    """Carries out the actions of one kind."""

    def prepare(self, action: Action) -> None:
        """Makes what an action needs before it is needed: discovery takes time.

        Raises:
            NetError: No such interface.
        """

    async def perform(self, activity: Activity, context: ActionContext) -> None:
        """Carries an action out.

        Raises:
            ImError: It failed.
        """


class Surroundings:
    """What actions reach other tasks with.

    Args:
        node: The node.
        functions: Registered builders and handlers.
        heartbeats: Tells who is alive.
    """

    def __init__(self, node: ManagedNode, functions: Functions, heartbeats: Heartbeats) -> None:
        self.node = node
        self.functions = functions
        self.heartbeats = heartbeats

    async def wait(self, future: Any, task: str | None, timeout_s: float, what: str) -> Any:
        """Awaits what another task will complete, while it lives.

        Raises:
            LinkError: The task died.
            WaitTimeoutError: It did not complete in time.
        """
        if task is None:
            return await wait(self.node, future, timeout_s, what)
        return await self.heartbeats.wait(future, task, timeout_s, what)

    async def until_ready(
        self, ready: Callable[[], bool], made: float, task: str | None, what: str, limit_s: float = DISCOVERY_TIMEOUT_S
    ) -> None:
        """Waits for a server to be discovered, and to have discovered us: what is sent before may be lost.

        Args:
            ready: Whether the server is discovered.
            made: When the client was made (monotonic) [s].
            task: Task of the server, if it is known.
            what: What is waited for.
            limit_s: Longest wait [s].

        Raises:
            StateError: It is not there.
        """
        deadline = monotonic() + limit_s
        since = self.heartbeats.incarnation(task) if task else None
        while not ready():
            missing = self.heartbeats.missing(task, since) if task else ""
            if missing or monotonic() > deadline:
                raise StateError(f"{what} is not there" + (f": {missing}" if missing else ""))
            await pause(self.node, 0.05)
        heard = self.heartbeats.heard_since(task) if task else None
        settled = SETTLING_S + max(made, heard or made)
        if settled > monotonic():
            await pause(self.node, settled - monotonic())

    def task(self, action: ServiceAction | GoalAction) -> str | None:
        """Returns the task whose heartbeat is watched while an answer is awaited."""
        if action.task is not None:
            return action.task
        first = action.name.strip("/").partition("/")[0]
        return first if self.heartbeats.incarnation(first) is not None else None

    async def fields(
        self, action: ServiceAction | GoalAction | TopicAction, context: ActionContext
    ) -> dict[str, object]:
        """Returns the fields of what is sent.

        Raises:
            NetError: The builder returned something else.
        """
        built: object = {}
        if action.build:
            built = self.functions.actions[action.build](context)
            if inspect.isawaitable(built):
                built = await built
        if not isinstance(built, dict):
            raise NetError(f"builder {action.build} returned {built!r}, not a dict of fields")
        return {**action.fields, **built}

    async def handled(self, action: ServiceAction | GoalAction, context: ActionContext, answer: Any) -> None:
        """Has the registered handler read an answer."""
        if action.handle:
            outcome = self.functions.actions[action.handle](context, answer)
            if inspect.isawaitable(outcome):
                await outcome


def time_left(activity: Activity, default: float) -> float:
    """Time to wait for an answer [s]: where the net sets a limit, that one is to strike, and a late answer counts."""
    return default if activity.deadline is None else max(0.0, activity.deadline - monotonic()) + LATE_ANSWER_S


def require_success(answer: Any, what: str) -> None:
    """Checks the field ``success`` of an answer, if it has one.

    Raises:
        ImError: It is false; with what the answer says.
    """
    if getattr(answer, "success", True) is False:
        raise failure_of(answer, f"{what} did not succeed", "failed")


def failure_of(answer: Any, otherwise: str, code: str) -> ImError:
    """Returns the failure that an answer tells of, by its ``status``, ``message`` or ``error_string``."""
    status = getattr(answer, "status", None)
    if status is not None and hasattr(status, "message") and status.message:
        return status_to_error(status)
    message = getattr(answer, "message", "") or getattr(answer, "error_string", "")
    return ImError(message or otherwise, code=code)
