"""Base class of every node: start-up phases, heartbeat, and waking of coroutines."""

import inspect
import os
import secrets
import socket
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from std_msgs.msg import UInt8

from im_core import clock
from im_core.errors import ImError, NotFoundError
from im_core.ros import qos
from im_core.ros.alarms import Alarms
from im_core.ros.coroutines import Coroutines, Promise, Work
from im_msgs.msg import TaskStatus

PHASE_LOAD, PHASE_CONFIGURE, PHASE_START, PHASE_SHUTDOWN = range(4)

PHASE_TOPIC = "/im/phase"
STATUS_TOPIC = "/im/task_status"
HEARTBEAT_PERIOD_S = 0.5

INTROSPECTION = {
    "off": ServiceIntrospectionState.OFF,
    "metadata": ServiceIntrospectionState.METADATA,
    "contents": ServiceIntrospectionState.CONTENTS,
}
WAKE_DELAY_S = 0.0002
_READY = int(TaskStatus.READY)


class ManagedNode(Node):
    """A task of the machine (paper, section 3): loaded, configured and started in step with all others.

    The bootstrap announces the phases LOAD, CONFIGURE, START and SHUTDOWN on ``/im/phase``; the node follows,
    and tells where it is on ``/im/task_status``. With the parameter ``standalone:=true`` it passes through
    the phases alone; with ``introspection:=metadata`` or ``contents`` all its services and clients publish what
    they carry on ``<service>/_service_event``. Subclasses override :meth:`phase_configure`,
    :meth:`phase_start` and :meth:`phase_shutdown`.
    """

    _introspection = ServiceIntrospectionState.OFF

    def __init__(self, name: str, **kwargs: object) -> None:
        super().__init__(name, **kwargs)
        introspection = self.declare_parameter("introspection", "off").value
        if introspection not in INTROSPECTION:
            raise NotFoundError(kind="kind of introspection", name=str(introspection), known=INTROSPECTION)
        self._introspection = INTROSPECTION[introspection]
        self.task_name = name
        self.incarnation = secrets.randbits(63)
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._phase = TaskStatus.LOADED
        self._detail = ""
        self._stopped = False
        self.alarms = Alarms(self)
        self._wake_timer = self.create_timer(WAKE_DELAY_S, self._woken, clock=self.steady_clock)
        self._wake_timer.cancel()
        self._coroutines = Coroutines(self.wake, self._poll, self._broken)
        self._status_publisher = self.create_publisher(TaskStatus, STATUS_TOPIC, qos.STATUS)
        self.create_timer(HEARTBEAT_PERIOD_S, self._publish_status, clock=self.steady_clock)
        standalone = self.declare_parameter("standalone", False).value
        if standalone:
            self._standalone_timer = self.create_timer(0.01, self._start_alone, clock=self.steady_clock)
        else:
            self.create_subscription(UInt8, PHASE_TOPIC, lambda message: self._follow(message.data), qos.LATCHED)
        self._publish_status()

    def create_service(self, *args: object, **kwargs: object) -> Service:
        """As in rclpy, with queues for many clients, and introspection as the node's parameter says."""
        kwargs.setdefault("qos_profile", qos.SERVICES)
        service = super().create_service(*args, **kwargs)
        service.configure_introspection(self.get_clock(), qos.EVENTS, self._introspection)
        service.send_response = partial(self._send_when_done, service, service.send_response)
        return service

    def _send_when_done(self, service: Service, send: Callable[..., None], response: Any, header: object) -> None:
        """Send what a service's callback returned; the events executor would take a coroutine for the response."""
        if not inspect.iscoroutine(response):
            send(response, header)
            return

        def finished(task: Any) -> None:
            if (error := task.exception()) is not None:
                self.get_logger().error(f"{service.srv_name} failed: {error!r}")
            if rclpy.ok():
                send(service.srv_type.Response() if error is not None else task.result(), header)

        self.executor.create_task(response).add_done_callback(finished)

    def create_client(self, *args: object, **kwargs: object) -> Client:
        """As in rclpy, with introspection as the node's parameter says."""
        client = super().create_client(*args, **kwargs)
        client.configure_introspection(self.get_clock(), qos.EVENTS, self._introspection)
        return client

    def phase_configure(self) -> None:
        """Load the configuration, open what is shared, start child processes.

        Raises:
            ImError: It cannot be done; the node reports FAILED with the sentence.
        """

    def phase_start(self) -> None:
        """Begin to serve.

        Raises:
            ImError: It cannot be done; the node reports FAILED with the sentence.
        """

    def phase_shutdown(self) -> None:
        """Release everything; called once, whatever happened before."""

    @property
    def ready(self) -> bool:
        """Whether all start-up phases are passed."""
        return bool(self._phase == _READY)

    @property
    def failed(self) -> str:
        """Why the node failed, or an empty string."""
        return self._detail if self._phase == TaskStatus.FAILED else ""

    def fail(self, error: ImError) -> None:
        """Report that this task cannot go on."""
        self._set_phase(TaskStatus.FAILED, error.message)
        self.get_logger().error(error.message)

    def promise(self) -> Promise:
        """A future for coroutines of this node that any thread may complete."""
        return Promise(self.wake)

    def spawn(self, work: Work) -> None:
        """Run a coroutine in the loop; it costs nothing while it waits for a promise. From any thread."""
        self._coroutines.spawn(work)

    def wake(self) -> None:
        """Let the executor look at its suspended coroutines soon; from any thread."""
        if rclpy.ok():
            self._wake_timer.reset()

    def shut_down_once(self) -> None:
        """Run :meth:`phase_shutdown` if it has not been run."""
        if self._stopped:
            return
        self._stopped = True
        self._phase = TaskStatus.STOPPING
        if rclpy.ok():
            self._publish_status()
        try:
            self.phase_shutdown()
        except ImError as error:
            self.get_logger().error(error.message)

    def _woken(self) -> None:
        self._wake_timer.cancel()
        self._coroutines.step()

    def _poll(self, work: Work) -> None:
        self.executor.create_task(work)

    def _broken(self, error: Exception) -> None:
        self.get_logger().error(f"a coroutine broke: {error!r}")

    def _start_alone(self) -> None:
        self._standalone_timer.cancel()
        self._follow(PHASE_START)

    def _follow(self, target: int) -> None:
        if target == PHASE_SHUTDOWN:
            self.shut_down_once()
            rclpy.try_shutdown()
            return
        if target >= PHASE_CONFIGURE and self._phase == TaskStatus.LOADED:
            self._run_phase(self.phase_configure, TaskStatus.CONFIGURED)
        if target >= PHASE_START and self._phase == TaskStatus.CONFIGURED:
            self._run_phase(self.phase_start, TaskStatus.READY)

    def _run_phase(self, phase: object, reached: int) -> None:
        try:
            phase()
        except ImError as error:
            self.fail(error)
        else:
            self._set_phase(reached, "")

    def _set_phase(self, phase: int, detail: str) -> None:
        self._phase, self._detail = phase, detail
        self._publish_status()

    def _publish_status(self) -> None:
        message = TaskStatus(
            name=self.task_name,
            node=self.get_fully_qualified_name(),
            host=socket.gethostname(),
            pid=os.getpid(),
            incarnation=self.incarnation,
            phase=self._phase,
            detail=self._detail,
        )
        seconds = clock.wall()
        message.stamp.sec = int(seconds)
        message.stamp.nanosec = int((seconds % 1.0) * 1e9)
        self._status_publisher.publish(message)
