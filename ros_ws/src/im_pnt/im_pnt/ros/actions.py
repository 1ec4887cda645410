"""Actions of transitions that reach other tasks: service calls, publications, and what action goals share with them."""

import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from rclpy.client import Client
from rclpy.publisher import Publisher

from im_core.clock import monotonic
from im_core.errors import ImError, StateError, nearest
from im_core.ros import qos
from im_core.ros.calls import pause, wait
from im_core.ros.heartbeats import Heartbeats
from im_core.ros.interfaces import interface_class
from im_core.ros.node import ManagedNode
from im_core.ros.status import status_to_error
from im_pnt.errors import NetError
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.jobs import Activity
from im_pnt.model.action import Action, GoalAction, ServiceAction, TopicAction

DISCOVERY_TIMEOUT_S = 20.0
"""Time in which a server that lives is discovered, also on a busy computer [s]."""
SETTLING_S = 2.0
"""Time in which a client and its server have certainly discovered each other, both ways [s]."""
LATE_ANSWER_S = 30.0
SERVICE_TIMEOUT_S = 30.0

_SEQUENCE = re.compile(r"(?:sequence<(?P<bounded>[^,>]+)(?:, *\d+)?>|(?P<array>[^\[]+)\[\d*\])")


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

    async def until_ready(self, ready: Callable[[], bool], made: float, task: str | None, what: str) -> None:
        """Waits for a server to be discovered, and to have discovered us: what is sent before may be lost.

        Args:
            ready: Whether the server is discovered.
            made: When the client was made (monotonic) [s].
            task: Task of the server, if it is known.
            what: What is waited for.

        Raises:
            StateError: It is not there.
        """
        deadline = monotonic() + DISCOVERY_TIMEOUT_S
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


class ServiceActions:
    """Calls services; an answer with ``success`` false is a failure."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings
        self._clients: dict[str, tuple[Client, float]] = {}

    def prepare(self, action: Action) -> None:
        """Makes the client of an action.

        Raises:
            NetError: No such interface.
        """
        assert isinstance(action, ServiceAction)
        self._client(action)

    async def perform(self, activity: Activity, context: ActionContext) -> None:
        """Calls a service and has its answer handled.

        Raises:
            ImError: It failed, or did not answer in time.
        """
        action = activity.action
        assert isinstance(action, ServiceAction)
        around, (client, made) = self._surroundings, self._client(action)
        request = fill(interface_class(action.type).Request(), await around.fields(action, context), str(action))
        task = around.task(action)
        what = f"transition {activity.transition}"
        await around.until_ready(client.service_is_ready, made, task, f"the service {action.name} ({what})")
        limit = time_left(activity, SERVICE_TIMEOUT_S)
        response = await around.wait(client.call_async(request), task, limit, f"an answer of {action.name} ({what})")
        require_success(response, str(action))
        await around.handled(action, context, response)

    def _client(self, action: ServiceAction) -> tuple[Client, float]:
        """The client of a service, and when it was made."""
        if action.name not in self._clients:
            client = self._surroundings.node.create_client(interface_class(action.type), action.name)
            self._clients[action.name] = (client, monotonic())
        return self._clients[action.name]


class TopicActions:
    """Publishes messages; an action has confirmed when the middleware has taken its message."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings
        self._publishers: dict[tuple[str, str], Publisher] = {}

    def prepare(self, action: Action) -> None:
        """Makes the publisher of an action.

        Raises:
            NetError: No such interface.
        """
        assert isinstance(action, TopicAction)
        self._publisher(action)

    async def perform(self, activity: Activity, context: ActionContext) -> None:
        """Publishes one message.

        Raises:
            NetError: A field does not fit.
        """
        action = activity.action
        assert isinstance(action, TopicAction)
        fields = await self._surroundings.fields(action, context)
        self._publisher(action).publish(fill(interface_class(action.type)(), fields, str(action)))

    def _publisher(self, action: TopicAction) -> Publisher:
        key = (action.name, action.type)
        if key not in self._publishers:
            node = self._surroundings.node
            self._publishers[key] = node.create_publisher(interface_class(action.type), action.name, qos.EVENTS)
        return self._publishers[key]


# What they are made of, and what is read from answers.


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


def fill(message: Any, fields: Mapping[str, object], where: str) -> Any:
    """Sets fields of a message from plain data or from messages; returns the message.

    Args:
        message: A message, request or goal.
        fields: Values by name; a mapping fills a nested message.
        where: What is filled, for messages.

    Raises:
        NetError: No such field, or a value that does not fit.
    """
    types = message.get_fields_and_field_types()
    message._check_fields = True  # otherwise a wrong type is met first by the serialiser, which aborts the process
    for name, value in fields.items():
        if name not in types:
            raise NetError(f"{where} has no field '{name}'{nearest(name, types)}", field=name)
        try:
            setattr(message, name, _fitted(getattr(message, name), types[name], value, f"{where}.{name}"))
        except (AssertionError, TypeError, ValueError) as error:
            raise NetError(f"{where}.{name} ({types[name]}) cannot be {value!r}: {error}", field=name) from error
    return message


def _fitted(present: Any, type_name: str, value: Any, where: str) -> Any:
    if isinstance(value, Mapping) and hasattr(present, "get_fields_and_field_types"):
        return fill(present, value, where)
    match = _SEQUENCE.fullmatch(type_name)
    if match and isinstance(value, list | tuple):
        element = match.group("bounded") or match.group("array")
        if "/" in element:
            make = interface_class(element.replace("/", "/msg/"))
            return [
                fill(make(), entry, f"{where}[{index}]") if isinstance(entry, Mapping) else entry
                for index, entry in enumerate(value)
            ]
        return [_number(entry, element) for entry in value]
    return _number(value, type_name)


def _number(value: Any, type_name: str) -> Any:
    """YAML writes 1 where a message wants 1.0."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    return float(value) if whole and type_name in ("double", "float") else value
