"""Base of every node: an exception in a callback is logged, counted and answered, and the node goes on.

A callback that raises would end the loop of the events executor, and with it the node; of a service, it would leave
the client waiting for ever.
"""

import inspect
import sys
import threading
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from action_msgs.msg import GoalInfo, GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer

from im_core.errors import FOREIGN, ImError, StateError, as_exception
from im_core.ros import qos
from im_core.ros.failures import Failures, few, sentence
from im_core.ros.logger import Logger
from im_core.ros.messages.interfaces import type_name
from im_core.ros.messages.status import to_status
from im_core.ros.open_requests import OpenRequests
from im_core.ros.peers.client_identity import client_of, nodes_of, process_of, sender_of
from im_core.ros.peers.servers import node_of
from im_core.ros.rclpy_fixes import one_reader
from im_core.ros.rclpy_fixes.action_events import ActionEvents
from im_core.ros.rclpy_fixes.backlog import serve_waiting
from im_core.ros.rclpy_fixes.late_answers import LateAnswers, unreached
from im_core.ros.rclpy_fixes.timers import punctual_timer
from im_core.ros.urgent import UrgentReaders

INTERNAL = "internal"

#: How long the loop of a node may stand still [s]; longer is a hang, and the agent ends the process.
STANDSTILL_S = 5.0

#: After this time without a result it is asked for again [s].
RESULT_AGAIN_S = 10.0

#: How long the result of a goal that has ended can be asked for [s].
RESULT_KEPT_S = 60

#: An ``error_code`` of control_msgs; those have 0 for success, and are negative else.
_FAULT = -1

#: The services of an action, as other services.
_ACTION_SERVICES = dict.fromkeys((f"{name}_service_qos_profile" for name in ("goal", "result", "cancel")), qos.SERVICES)


class GuardedNode(Node):
    """Node with callbacks allowed to raise.

    Attributes:
        failures: What they raised.
        late_answers: Answers whose clients are not reached yet.
        open_requests: Requests of its services that wait for their answers.
        refused: How many requests of its services were answered without success.
        urgent: Requests taken before waiting callbacks; one for all nodes of a loop.
        turns: How many callbacks have begun; it stands still with the loop.
        standstill_s: How long the loop may stand still now [s]; see :class:`im_core.processes.loop_watch.LoopWatch`.
            Whoever lowers it counts a turn first.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse an internal name of a class of another package: calls would reach the wrong method.

        Raises:
            TypeError: The class takes one.
        """
        super().__init_subclass__(**options)
        for base in cls.__mro__[1:]:
            if _package(base) == _package(cls):
                continue
            for name in vars(cls).keys() & vars(base).keys():
                if name.startswith("_") and not name.startswith("__"):
                    raise TypeError(f"{cls.__name__}.{name}: {base.__name__} uses this name itself; take another one")

    def __init__(self, name: str, **options: Any) -> None:
        self.failures = Failures(self)  # before the node: rclpy makes services and subscriptions of its own in it
        self.late_answers = LateAnswers(self, self._note_lost)
        self.open_requests = OpenRequests()
        self.refused = 0
        self.urgent = UrgentReaders()
        self.turns = 0
        self.standstill_s = STANDSTILL_S
        try:
            super().__init__(name, **options)
        except rclpy_implementation.RCLError as error:  # DDS security without its libraries, or without a keystore
            raise StateError(f"ROS makes no node '{name}': {str(error).splitlines()[0]}") from error
        self._logger: RcutilsLogger = Logger(Node.get_logger(self).name)

    @property
    def tells_contents(self) -> bool:
        """Whether services and actions publish all contents carried."""
        return False

    def begin(self, work: Coroutine[object, object, None]) -> None:
        """Run a coroutine in the loop, from a callback."""
        assert self.executor is not None, "only an executor calls callbacks"
        self.executor.create_task(work)

    def turn(self) -> None:
        """Turn once more, after urgent requests."""
        self.urgent.look()
        self.turns += 1

    def get_logger(self) -> RcutilsLogger:
        """Return the logger, of unknown type in rclpy; logging costs less."""
        return self._logger

    def guarded(self, what: str, callback: Callable[..., Any], told: Callable[[], str] = str) -> Callable[..., Any]:
        """Return a callback, noting exceptions of the given callback and then returning None.

        Args:
            what: Kind of callback, and the name of what it serves.
            callback: It.
            told: Says what came and who may have sent it, when it is asked.
        """

        def call(*arguments: Any) -> Any:
            self.turn()
            try:
                return callback(*arguments)
            except FOREIGN as error:  # whatever it is, the node goes on
                self.note_failure(what, as_exception(error), told)
                return None

        return call

    def note_failure(self, what: str, error: Exception, told: Callable[[], str] = str) -> None:
        """Note an exception of a callback; arguments as of :meth:`guarded`.

        Raises:
            Exception: The error itself, when ROS has been shut down: the loop ends by it.
        """
        if not self.context.ok():
            raise error
        self.failures.add(what, error, told)

    def _note_lost(self, what: str, error: Exception, sender: str) -> None:
        self.note_failure(f"{what} (its answer)", error, lambda: f"called by {self.callers(sender)}")

    def callers(self, sender: str) -> str:
        """Name the possible senders of a request (:func:`im_core.ros.peers.client_identity.sender_of`), as a text."""
        client = process_of(sender)
        return few(nodes_of(self, client)) or client or "nobody known"

    def create_subscription(
        self,
        msg_type: type[Any],
        topic: str,
        callback: Callable[[Any], Any],
        qos_profile: QoSProfile | int,
        **options: Any,
    ) -> Subscription:
        """As in rclpy; the callback takes the message alone, and nodes of one process may share the reader."""

        def told() -> str:
            ends = self.get_publishers_info_by_topic(self.resolve_topic_name(topic))
            names = sorted({node_of(end) for end in ends})
            return f"{type_name(msg_type)}, published by {few(names) or 'nobody any more'}"

        guarded = self.guarded(f"subscription {topic}", callback, told)
        make = partial(super().create_subscription, msg_type, topic, qos_profile=qos_profile, **options)
        return one_reader.follow(topic, lambda message: guarded(message), lambda told: make(callback=told))

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], Any],
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,
    ) -> Timer:
        """Create a timer as rclpy does; see :mod:`im_core.ros.rclpy_fixes.timers` for the difference."""
        name = getattr(callback, "__qualname__", type(callback).__qualname__)
        make = partial(super().create_timer, timer_period_sec)
        return punctual_timer(
            self, lambda strike: make(strike, callback_group, clock, autostart), self.guarded(f"timer {name}", callback)
        )

    def create_service(
        self,
        srv_type: type[Any],
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        qos_profile: QoSProfile = qos.SERVICES,
        callback_group: CallbackGroup | None = None,
        urgent: bool = False,
    ) -> Service:
        """Create a service as in rclpy, with queues for many clients; an answer is sent in any case.

        The callback may be a coroutine. It may also return a function: that is given who called, as
        :func:`im_core.ros.peers.client_identity.client_of` says, and returns what the callback would have returned.
        Requests to an urgent service are taken before other callbacks that wait.
        """
        service = super().create_service(
            srv_type, srv_name, callback, qos_profile=qos_profile, callback_group=callback_group
        )
        _Answers(self, service)
        if urgent:
            self.urgent.add(partial(serve_waiting, service))
        return service

    def create_client(
        self,
        srv_type: type[Any],
        srv_name: str,
        *,
        qos_profile: QoSProfile = qos.SERVICES,
        callback_group: CallbackGroup | None = None,
    ) -> Client:
        """Create a client as in rclpy, with a queue for many answers: every client also gets answers to others."""
        return super().create_client(srv_type, srv_name, qos_profile=qos_profile, callback_group=callback_group)


class GuardedActionServer(ActionServer):
    """Action server with callbacks allowed to raise: the goal is rejected, or aborted with the reason in the result.

    What a goal asked is forgotten with its end, and its result a minute later, so that goals by the thousand, or of
    thousands of points each, do not add up. A cancellation is taken before other callbacks that wait.
    """

    def __init__(
        self,
        node: GuardedNode,
        action_type: Any,
        action_name: str,
        execute_callback: Callable[[ServerGoalHandle], Any],
        **options: Any,
    ) -> None:
        self._guard, self._what = node, f"action {action_name}"
        self._told = partial(type_name, action_type)
        self._events = ActionEvents(node, action_type, action_name) if node.tells_contents else None
        ActionServer.__init__(
            self,
            node,
            action_type,
            action_name,
            execute_callback,
            result_timeout=RESULT_KEPT_S,
            **_ACTION_SERVICES,
            **options,
        )
        node.urgent.add(self._take_cancellations)

    def _take_cancellations(self) -> None:
        """Begin the cancellations that wait, each after the goals that wait: all goals may be meant.

        Raises:
            InvalidHandle: The server was destroyed.
        """
        types = self._action_type.Impl
        with self._handle:
            while all(cancellation := self._handle.take_cancel_request(types.CancelGoalService.Request)):
                while all(goal := self._handle.take_goal_request(types.SendGoalService.Request)):
                    self._guard.begin(self.execute({"goal": goal}))
                self._guard.begin(self.execute({"cancel": cancellation}))

    def register_goal_callback(self, goal_callback: Callable[[Any], Any] | None) -> None:
        """Register the goal callback as in rclpy; a goal is rejected if the callback raises."""
        guarded = goal_callback and self._or(goal_callback, GoalResponse.REJECT)
        ActionServer.register_goal_callback(self, guarded)

    def register_cancel_callback(self, cancel_callback: Callable[[Any], Any] | None) -> None:
        """Register the cancel callback as in rclpy; an undecidable goal is not cancelled."""
        guarded = cancel_callback and self._or(cancel_callback, CancelResponse.REJECT)
        ActionServer.register_cancel_callback(self, guarded)

    def register_execute_callback(self, execute_callback: Callable[[Any], Any]) -> None:
        """Register the execute callback as in rclpy; a raising callback aborts the goal, the result gives a reason."""

        async def execute(handle: ServerGoalHandle) -> Any:
            self._tell(lambda events: events.tell_goal(handle))
            try:
                result = execute_callback(handle)
                result = await result if inspect.iscoroutine(result) else result
            except FOREIGN as raised:  # every goal is answered
                error = as_exception(raised)
                self._guard.note_failure(self._what, error, self._told)
                if handle.is_active:
                    handle.abort()
                result = with_fault(self._action_type.Result(), self._what, error)
            self._tell(lambda events: events.tell_result(handle, result))
            handle._goal_request = None  # rclpy keeps it with the result
            return result

        ActionServer.register_execute_callback(self, execute)

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Callable[[Any], Any] | None) -> None:
        """Begin a goal in the node's loop; rclpy's executor would look at every waiting goal after each event."""
        run: Callable[..., Coroutine[object, object, None]] = self._execute_goal  # rclpy says no types
        self._guard.begin(run(execute_callback or self._execute_callback, goal_handle))

    async def execute(self, taken_data: Any) -> None:
        """Handle a taken request, as in rclpy; rclpy calls the method for every request."""
        self._guard.turn()
        try:
            await ActionServer.execute(self, taken_data)
        except Exception as error:  # the other goals go on
            self._guard.note_failure(self._what, error, self._told)

    def _tell(self, tell: Callable[[ActionEvents], None]) -> None:
        """Publish an event of the action, if any; a goal is carried out even if the event cannot be told."""
        if self._events is not None:
            try:
                tell(self._events)
            except Exception as error:
                self._guard.note_failure(f"{self._what} (its event)", error, self._told)

    def _or(self, callback: Callable[[Any], Any], otherwise: Any) -> Callable[[Any], Any]:
        guarded = self._guard.guarded(self._what, callback, self._told)

        def call(argument: Any) -> Any:
            answer = guarded(argument)
            return otherwise if answer is None else answer

        return call

    async def _execute_goal_request(self, request_header_and_message: Any) -> None:
        header, request = request_header_and_message
        goal_id = bytes(request.goal_id.uuid)
        known = goal_id in self._goal_handles
        try:
            await ActionServer._execute_goal_request(self, request_header_and_message)
            return
        except SystemError as error:  # rclpy goes no further then
            if not unreached(error):
                raise
        goal = None if known else self._goal_handles.get(goal_id)
        response = self._action_type.Impl.SendGoalService.Response(accepted=goal is not None)
        response.stamp = self._guard.get_clock().now().to_msg()
        self._guard.late_answers.keep(self._what, header, partial(self._handle.send_goal_response, header, response))
        if goal is not None:
            self._handle.publish_status()
            goal.execute()

    async def _execute_cancel_request(self, request_header_and_message: Any) -> None:
        header, request = request_header_and_message
        self._tell(lambda events: events.tell_cancel(request))
        try:
            await ActionServer._execute_cancel_request(self, request_header_and_message)
        except SystemError as error:
            if not unreached(error):
                raise
            answer = partial(self._handle.send_cancel_response, header, self._cancelling(request))
            self._guard.late_answers.keep(self._what, header, answer)

    def _cancelling(self, request: Any) -> Any:
        """Return the answer to a completed cancellation; rclpy has dropped the original answer."""
        asked = bytes(request.goal_info.goal_id.uuid)  # zeros stand for all goals
        chosen = [handle for uuid, handle in self._goal_handles.items() if uuid == asked or not any(asked)]
        cancelling = [GoalInfo(goal_id=handle.goal_id) for handle in chosen if handle.is_cancel_requested]
        code = CancelGoal.Response.ERROR_NONE if cancelling else CancelGoal.Response.ERROR_REJECTED
        return CancelGoal.Response(return_code=code, goals_canceling=cancelling)

    async def _execute_get_result_request(self, request_header_and_message: Any) -> None:
        header, _ = request_header_and_message
        try:
            await ActionServer._execute_get_result_request(self, request_header_and_message)
        except SystemError as error:
            if not unreached(error):
                raise
            unknown = self._action_type.Impl.GetResultService.Response(status=GoalStatus.STATUS_UNKNOWN)
            answer = partial(self._handle.send_result_response, header, unknown)
            self._guard.late_answers.keep(self._what, header, answer)

    def _send_result_response(self, request_header: Any, future: Any) -> None:
        send = partial(ActionServer._send_result_response, self, request_header, future)
        try:
            self._guard.late_answers.send(self._what, request_header, send)
        except Exception as error:  # a result that no message can carry
            self._guard.note_failure(f"{self._what} (its result)", error, self._told)
            response = self._action_type.Impl.GetResultService.Response(status=future.result().status)
            response.result = with_fault(self._action_type.Result(), self._what, error)
            self._handle.send_result_response(request_header, response)


class GuardedActionClient(ActionClient):
    """Action client with a feedback callback allowed to raise; usable from any thread.

    rclpy notes what was asked only after it was sent: an answer that comes before that is dropped. A result is asked
    for again and again: the answer of a server to a process that was silent for longer than the lease of discovery,
    as one that was stopped, is lost.
    """

    def __init__(self, node: GuardedNode, action_type: Any, action_name: str) -> None:
        self._guard, self._what = node, f"action client {action_name}"
        self._asking = threading.Lock()
        self._awaited: dict[Future, Any] = {}  # the goals whose results are awaited
        ActionClient.__init__(self, node, action_type, action_name, **_ACTION_SERVICES)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._again = node.create_timer(RESULT_AGAIN_S, self._ask_again, clock=steady)

    def send_goal_async(self, *arguments: Any, **options: Any) -> Future:
        """As in rclpy."""
        with self._asking:
            future: Future = ActionClient.send_goal_async(self, *arguments, **options)
        return future

    def _get_result_async(self, goal_handle: Any) -> Future:
        with self._asking:
            future: Future = ActionClient._get_result_async(self, goal_handle)
            self._awaited[future] = goal_handle
        return future

    def _ask_again(self) -> None:
        with self._asking:
            self._awaited = {future: goal for future, goal in self._awaited.items() if not future.done()}
            for future, goal in self._awaited.items():
                again: Future = ActionClient._get_result_async(self, goal)
                again.add_done_callback(partial(_pass_on, future))

    def destroy(self) -> None:
        """As in rclpy."""
        self._guard.destroy_timer(self._again)
        ActionClient.destroy(self)

    def _cancel_goal_async(self, goal_handle: Any) -> Future:
        with self._asking:
            future: Future = ActionClient._cancel_goal_async(self, goal_handle)
        return future

    async def execute(self, taken_data: Any) -> None:
        """Handle a taken answer or feedback, as in rclpy; rclpy calls the method for each."""
        self._guard.turn()
        with self._asking:
            pass  # whoever has sent has noted it
        try:
            await ActionClient.execute(self, taken_data)
        except Exception as error:  # the other goals go on
            self._guard.note_failure(self._what, error)


def _pass_on(awaited: Future, answered: Future) -> None:
    if not awaited.done():
        awaited.set_result(answered.result())


class _Raised:
    """Exception of a service's callback, on the way to the code with the client's identity."""

    def __init__(self, error: Exception) -> None:
        self.error = error


class _Answers:
    """Stands between rclpy and a service: calls the callback, and sends one answer to each request.

    Args:
        node: The node of the service.
        service: It; from now on rclpy calls what is here.
    """

    def __init__(self, node: GuardedNode, service: Service) -> None:
        self._node, self._service = node, service
        self._what = f"service {service.srv_name}"
        self._callback, self._send = service.callback, service.send_response
        hooked: Any = service  # rclpy calls what it finds under these names
        hooked.callback, hooked.send_response = self._call, self._answer

    def _call(self, request: Any, response: Any) -> Any:
        self._node.turn()
        try:
            return self._callback(request, response)
        except FOREIGN as error:  # answered where the client is known
            return _Raised(as_exception(error))

    def _answer(self, response: Any, header: Any) -> None:
        """Send the return value of the callback; the events executor would take a coroutine for the response."""
        try:
            if callable(response):
                response = response(client_of(header))
            if isinstance(response, _Raised):
                raise response.error
            if not inspect.iscoroutine(response):
                self._deliver(response, header)
                return
        except FOREIGN as error:  # every request is answered
            self._refuse(as_exception(error), header)
            return
        self._node.begin(self._finish(response, header))

    async def _finish(self, response: Any, header: Any) -> None:
        ticket = self._node.open_requests.begin()
        try:
            self._deliver(await response, header)
        except FOREIGN as error:  # as above
            self._refuse(as_exception(error), header)
        finally:
            self._node.open_requests.end(ticket)

    def _deliver(self, response: Any, header: Any) -> None:
        self._node.refused += getattr(response, "success", True) is False
        self._node.late_answers.send(self._what, header, partial(self._send, response, header))

    def _refuse(self, error: Exception, header: Any) -> None:
        """Note the exception, and answer with a refusal of the request."""
        srv_type: Any = self._service.srv_type

        def told() -> str:
            return f"{type_name(srv_type)}, called by {self._node.callers(sender_of(header))}"

        what = self._what
        self._node.note_failure(what, error, told)
        try:
            self._deliver(with_fault(srv_type.Response(), what, error), header)
        except Exception as again:  # the client may be gone
            self._node.note_failure(f"{what} (its answer)", again, told)


def with_fault(answer: Any, what: str, error: Exception) -> Any:
    """Return an answer with the callback's exception, in the fault fields of the answer's type.

    Args:
        answer: A response or a result as made; it does not say ``success``.
        what: Whose answer it is.
        error: What was raised.
    """
    words = f"fault in {what}: {sentence(error)}"
    types = answer.get_fields_and_field_types()
    if types.get("status") == "im_msgs/Status":
        answer.status = to_status(ImError(words, code=INTERNAL))
    for field in ("message", "status_message", "error_string", "reason"):
        if types.get(field) == "string":
            setattr(answer, field, words)
    if types.get("error_code") == "int32":
        answer.error_code = _FAULT
    return answer


def _package(cls: type) -> str:
    """Return the package of a class, also in a module run by ``python -m``."""
    spec = getattr(sys.modules["__main__"], "__spec__", None) if cls.__module__ == "__main__" else None
    return (spec.name if spec is not None else cls.__module__).partition(".")[0]
