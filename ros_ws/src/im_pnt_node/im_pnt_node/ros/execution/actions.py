"""Actions of transitions on other tasks: service calls, publications, and the common part with goals."""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from typing import Any, Generic, TypeVar

from rclpy.client import Client
from rclpy.publisher import Publisher

from im_core.clock import monotonic
from im_core.errors import ImError, LinkError, StateError
from im_core.processes.startup import patience_s
from im_core.ros import qos
from im_core.ros.calls import pause, wait
from im_core.ros.failures import few
from im_core.ros.heartbeats import LEASE_S, Heartbeats
from im_core.ros.messages.interfaces import interface_class
from im_core.ros.messages.message_fields import filled
from im_core.ros.messages.status import status_to_error
from im_core.ros.node import ManagedNode
from im_core.ros.peers.servers import doubted, offered_alike, server_ends, servers_of, sure_to_live
from im_pnt.errors import NetError
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.jobs import Activity
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt_node.rerun.log import MissionLog
from im_pnt_node.ros.execution.endpoints import EndpointGoesError, RosAction
from im_pnt_node.ros.messages import packed_message, plain_fields

DISCOVERY_TIMEOUT_S = 20.0
"""Time in which a server that lives is discovered, also on a busy computer [s]."""
SETTLING_S = 2.0
"""Time in which a client and its server have certainly discovered each other, both ways [s]."""
SUCCESSION_S = LEASE_S + 2.0
"""How long a killed server of another host stays in the graph of ROS, beside the one started in its place [s]."""
LATE_ANSWER_S = 30.0
LOOK_S, GONE_LOOKS = 0.5, 4
"""How often it is looked whether a server that sends no heartbeats is there [s]; so often in vain, and it is gone."""
SERVICE_TIMEOUT_S = 30.0


ClientT = TypeVar("ClientT")


class WatchedServer(Generic[ClientT]):
    """Server of a name, sought by a client: once found it may go away and come back.

    Attributes:
        client: The client.
        made: When the search began (monotonic) [s].
        found: Whether a server has been there.
    """

    def __init__(self, node: ManagedNode, client: ClientT, name: str, ready: Callable[[], bool]) -> None:
        self.client, self.made, self.found = client, monotonic(), False
        self._node, self._name, self._ready, self._alarms = node, name, ready, node.alarms
        self._alarm = self._alarms.after(LOOK_S, self._look)

    def ready(self) -> bool:
        """Return whether a server is there now."""
        there = self._ready() and bool(self.ends())
        self.found = self.found or there
        return there

    def ends(self) -> frozenset[bytes]:
        """Return the identities of the servers that are there now: a server that is started again has a new one."""
        return frozenset(bytes(end.endpoint_gid) for end in server_ends(self._node, self._name))

    def stop(self) -> None:
        """End the search, before the client is destroyed."""
        self._alarms.cancel(self._alarm)

    def _look(self) -> None:
        if not (self.found or self.ready()):
            self._alarm = self._alarms.after(LOOK_S, self._look)


class Surroundings:
    """Surroundings of actions: node, functions, heartbeats, log.

    Args:
        node: The node.
        functions: Registered builders and handlers.
        heartbeats: Tells who is alive.
        log: Is told what is sent, and what is answered.
        keep: Has on file what the builder of an action has left in its job.

    Attributes:
        waits_for_all: Whether servers that were never there are waited for: others start them with this node, or it
            goes on where an earlier process was killed, perhaps together with them.
    """

    def __init__(
        self,
        node: ManagedNode,
        functions: Functions,
        heartbeats: Heartbeats,
        log: MissionLog,
        keep: Callable[[Activity], None],
    ) -> None:
        self.node = node
        self.functions = functions
        self.heartbeats = heartbeats
        self.log = log
        self._keep = keep
        self.waits_for_all = True

    async def wait(self, future: Any, task: str | None, timeout_s: float, what: str, server: WatchedServer[Any]) -> Any:
        """Await the work of another node, while the node lives.

        Args:
            future: What it completes.
            task: The task, if it is one that tells that it lives.
            timeout_s: Longest wait [s].
            what: What is waited for.
            server: The server that was asked; looked for in the graph of ROS where it is no task.

        Raises:
            LinkError: It died.
            WaitTimeoutError: It did not complete in time.
        """
        if task is not None:
            return await self.heartbeats.wait(future, task, timeout_s, what)
        alarms, missed, asked = self.node.alarms, 0, server.ends()
        alarm = alarms.after(LOOK_S, lambda: look())

        def look() -> None:
            nonlocal alarm, missed
            missed = 0 if asked & server.ends() else missed + 1
            if missed < GONE_LOOKS:
                alarm = alarms.after(LOOK_S, look)
            elif not future.done():
                future.set_exception(LinkError(f"{what} will not come: the node that owes it is gone"))

        try:
            return await wait(self.node, future, timeout_s, what)
        finally:
            alarms.cancel(alarm)

    async def until_ready(
        self,
        server: WatchedServer[Any],
        name: str,
        task: str | None,
        what: str,
        unwanted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Wait for the discovery of a server in both directions: earlier requests may be lost.

        One that died, stood still, or went away is waited for, too: it may be there again soon. One whose task
        starts, and could not do yet what it is asked for, is waited for as long as a start may take. One of no task
        that was never there is not waited for once no node has come or gone for :data:`SETTLING_S`. Of two servers that
        are no tasks, each would take the request: nothing is sent before one is alone.

        Args:
            server: The server.
            name: Its name.
            task: Task of the server, if it is known.
            what: What is waited for.
            unwanted: Whether nothing is to be sent any more.

        Raises:
            StateError: It is not there, or not alone.
        """
        began, changed, nodes = monotonic(), server.made, self._nodes()
        while not unwanted() and ((why := self._not_yet(task)) or not server.ready()):
            starts = task is not None and self.heartbeats.starting(task)
            if monotonic() > began + (patience_s() if starts else DISCOVERY_TIMEOUT_S):
                raise StateError(f"{what} is not there: {why or f'waited {DISCOVERY_TIMEOUT_S:g} s for it'}")
            if not (self.waits_for_all or task or server.found):
                if nodes != (nodes := self._nodes()):
                    changed = monotonic()
                if monotonic() > changed + SETTLING_S and not servers_of(self.node, name):
                    where = f"in ROS domain {self.node.context.get_domain_id()}"
                    raise StateError(f"nobody offers {what} {where}{offered_alike(self.node, name)}")
            await pause(self.node, 0.05)
        heard = self.heartbeats.heard_since(task) if task else None
        await self.settle(max(server.made, heard or server.made))
        if task is None:  # now that a second server has been discovered, too
            await self._until_alone(name, what, unwanted)

    async def settle(self, since: float) -> None:
        """Wait until an endpoint has been discovered, both ways; messages before may be lost.

        Args:
            since: When it was made, or its other side was heard again (monotonic) [s].
        """
        if (settled := since + SETTLING_S) > monotonic():
            await pause(self.node, settled - monotonic())

    async def _until_alone(self, name: str, what: str, unwanted: Callable[[], bool]) -> None:
        began = monotonic()
        while len(servers := servers_of(self.node, name)) > 1 and not unwanted():
            if monotonic() > began + SUCCESSION_S or sure_to_live(self.node, name) > 1:
                told = f"{len(servers)} nodes serve {what}: {few(servers)}; nothing is sent, for each would take it"
                raise StateError(f"{told}; end all but one, or give each a namespace", servers=servers)
            await pause(self.node, LOOK_S)

    def _nodes(self) -> list[tuple[str, str]]:
        return sorted(self.node.get_node_names_and_namespaces())

    def _not_yet(self, task: str | None) -> str:
        """Why a task cannot be asked now, or an empty string."""
        if task is None:
            return ""
        if self.heartbeats.starting(task):
            return f"{task} has not come to the end of its start"
        return self.heartbeats.missing(task)

    def task(self, action: ServiceAction | GoalAction) -> str | None:
        """Return the task with the watched heartbeat during a wait for an answer."""
        if action.task is not None:
            return action.task
        first = action.name.strip("/").partition("/")[0]
        return first if self.heartbeats.incarnation(first) is not None else None

    def require_known_server(self, name: str, check: Callable[[], object]) -> None:
        """Name the servers where an action has failed, and a stranger may have answered; else nothing is raised.

        Args:
            name: Full name of the service or action.
            check: Raises the failure that the answer tells of.

        Raises:
            ImError: The failure, with all nodes that serve the name.
        """
        try:
            check()
        except ImError as error:
            if (told := doubted(self.node, error, name)) is not error:
                raise told from error

    async def sent(
        self, activity: Activity, action: ServiceAction | GoalAction | TopicAction, context: ActionContext, message: Any
    ) -> Any:
        """Return the filled and noted message of an action.

        Raises:
            ImError: As of :func:`fields_of`, a field does not fit, or what the builder has left cannot be kept.
        """
        filled(message, await fields_of(self.functions, action, context), str(action))
        self._keep(activity)
        self.log.sent(sent_key(activity), packed_message(message))
        return message


EndpointT = TypeVar("EndpointT")


class RosActions(ABC, Generic[EndpointT]):
    """Actions of one kind on other tasks, with their clients, publishers or subscriptions by name.

    The middleware takes no second type of a name in one process: what was made for a net that has gone makes room. It
    is gone when the executor has taken notice.
    """

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings
        self._made: dict[str, tuple[str, EndpointT]] = {}

    def prepare(self, action: RosAction) -> EndpointT:
        """Return the endpoint of an action; create the endpoint before the first use: discovery takes time.

        Raises:
            NotFoundError: No such type is installed.
            EndpointGoesError: It is of another type, and has been destroyed.
        """
        name = action.name
        if name not in self._made:
            self._made[name] = action.type, self._make(name, action.type)
        kind, made = self._made[name]
        if kind != action.type:
            del self._made[name]
            self._destroy(made)
            raise EndpointGoesError(f"{name} was of type {kind} and is to be of type {action.type}", name=name)
        return made

    @abstractmethod
    def perform(self, activity: Activity, context: ActionContext) -> Coroutine[object, object, dict[str, object]]:
        """Carry out an action, and return the kept part of the answer.

        Raises:
            ImError: It failed.
        """

    @abstractmethod
    def _make(self, name: str, type_name: str) -> EndpointT: ...

    @abstractmethod
    def _destroy(self, endpoint: EndpointT) -> None: ...


class ServiceActions(RosActions[WatchedServer[Client]]):
    """Calls services; an answer with ``success`` false is a failure."""

    async def perform(self, activity: Activity, context: ActionContext) -> dict[str, object]:
        """Call a service and handle the answer; return the kept part of the answer.

        Raises:
            ImError: It failed, or did not answer in time.
        """
        action = activity.action
        assert isinstance(action, ServiceAction)
        around, server = self._surroundings, self.prepare(action)
        client = server.client
        request = await around.sent(activity, action, context, interface_class(action.type).Request())
        task = around.task(action)
        what, name = f"transition {activity.transition}", around.node.resolve_service_name(action.name)

        async def call() -> Any:
            there = f"the service {name} ({what})"
            await around.until_ready(server, name, task, there, lambda: activity.cancelled)
            require_wanted(activity, action)
            limit = time_left(activity, SERVICE_TIMEOUT_S)
            waited = f"an answer of {name} ({what})"
            answer = await around.wait(client.call_async(request), task, limit, waited, server)
            around.require_known_server(name, lambda: require_success(answer, str(action)))
            return answer

        response = await around.log.read(answer_key(activity), call(), packed_message)
        require_success(response, str(action))
        return await handled(around.functions, action, context, response)

    def _make(self, name: str, type_name: str) -> WatchedServer[Client]:
        node = self._surroundings.node
        client = node.create_client(interface_class(type_name), name)
        return WatchedServer(node, client, node.resolve_service_name(name), client.service_is_ready)

    def _destroy(self, endpoint: WatchedServer[Client]) -> None:
        endpoint.stop()
        self._surroundings.node.destroy_client(endpoint.client)


class TopicActions(RosActions[tuple[Publisher, float]]):
    """Publisher of messages, with the time of its making; an action has confirmed once the middleware has a message."""

    async def perform(self, activity: Activity, context: ActionContext) -> dict[str, object]:
        """Publish one message, without an answer; a new publisher has to be discovered by its readers first.

        Raises:
            NetError: A field does not fit.
            ImError: It was cancelled before it was sent.
        """
        action = activity.action
        assert isinstance(action, TopicAction)
        publisher, made = self.prepare(action)
        message = await self._surroundings.sent(activity, action, context, interface_class(action.type)())
        await self._surroundings.settle(made)
        require_wanted(activity, action)
        publisher.publish(message)
        return {}

    def _make(self, name: str, type_name: str) -> tuple[Publisher, float]:
        return self._surroundings.node.create_publisher(interface_class(type_name), name, qos.EVENTS), monotonic()

    def _destroy(self, endpoint: tuple[Publisher, float]) -> None:
        self._surroundings.node.destroy_publisher(endpoint[0])


# What they are made of, and what is read from answers.


def sent_key(activity: Activity) -> list[object]:
    """Return the key of a noted request, goal or message of an action."""
    return ["action", activity.net, activity.number]


def answer_key(activity: Activity) -> list[object]:
    """Return the key of the noted answer."""
    return ["answer", activity.net, activity.number]


async def fields_of(
    functions: Functions, action: ServiceAction | GoalAction | TopicAction, context: ActionContext
) -> dict[str, object]:
    """Return the fields of an outgoing message.

    Raises:
        NetError: The builder returned something else.
        ImError: An expression has no value.
    """
    built: object = {}
    if action.build:
        built = functions.actions[action.build](context)
        if inspect.isawaitable(built):
            built = await built
    if not isinstance(built, dict):
        raise NetError(f"builder {action.build} returned {built!r}, not a dict of fields")
    fields = await context.filled(action.fields)
    assert isinstance(fields, dict)
    return {**fields, **built}


async def handled(
    functions: Functions, action: ServiceAction | GoalAction | AwaitAction, context: ActionContext, answer: Any
) -> dict[str, object]:
    """Read an answer with the registered handler, and return the fields needed by the net.

    Raises:
        ImError: One of them is no finite number.
    """
    if action.handle:
        outcome = functions.actions[action.handle](context, answer)
        if inspect.isawaitable(outcome):
            await outcome
    return plain_fields(answer, context.answer_ways, f"the answer of {action.name}")


def require_wanted(activity: Activity, action: ServiceAction | GoalAction | TopicAction) -> None:
    """Refuse to send for an action with a request to end.

    Raises:
        ImError: It was.
    """
    if activity.cancelled:
        raise ImError(f"{action} was cancelled before it was sent", code="cancelled")


def time_left(activity: Activity, default: float) -> float:
    """Return the time to wait for an answer [s]: a limit of the net strikes separately, and a late answer counts."""
    return default if activity.deadline is None else max(0.0, activity.deadline - monotonic()) + LATE_ANSWER_S


def require_success(answer: Any, what: str) -> None:
    """Check the fields ``success`` and ``error_code`` of an answer, if present.

    Raises:
        ImError: It did not succeed; with what the answer says.
    """
    if getattr(answer, "success", True) is False or _error_code(answer) is not None:
        raise failure_of(answer, f"{what} did not succeed", "failed")


def failure_of(answer: Any, otherwise: str, code: str) -> ImError:
    """Return the failure in an answer: the ``status``, or the ``error_code`` with the text."""
    status = getattr(answer, "status", None)
    if status is not None and hasattr(status, "message") and status.message:
        return status_to_error(status)
    words = next((text for name in _WORDS if (text := getattr(answer, name, ""))), "")
    number = _error_code(answer)
    if number is None:
        return ImError(words or otherwise, code=code)
    name = next((name for name, value in _codes(answer).items() if value == number), "error_code")
    sentence = ": ".join(part for part in (otherwise, f"{name} ({number})", words) if part)
    return ImError(sentence, code=code if name == "error_code" else name.lower(), error_code=number)


_WORDS = ("message", "error_string", "error_msg", "status_message")
_GOOD = ("SUCCESSFUL", "SUCCESS", "NONE", "OK")


def _error_code(answer: Any) -> int | None:
    """Return the named ``error_code`` of an answer (control_msgs, moveit_msgs); None for success."""
    code = getattr(answer, "error_code", None)
    code = getattr(code, "val", code)
    good = next((value for name, value in _codes(answer).items() if name in _GOOD), 0)
    return code if isinstance(code, int) and code != good else None


def _codes(answer: Any) -> dict[str, int]:
    """Return the constants of the message with the ``error_code``."""
    code = getattr(answer, "error_code", None)
    holder = type(code if hasattr(code, "val") else answer)
    return {name: value for name, value in vars(holder).items() if name.isupper() and isinstance(value, int)}
