"""Base class of every node: start-up phases, heartbeat, and waking of coroutines."""

import gc
import os
import secrets
import socket
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.task import Task

from im_core.errors import ImError
from im_core.processes.agent_socket import AgentOrder, AgentSocket, TaskIncarnation, TaskReport
from im_core.processes.process import dismiss_prepared
from im_core.processes.startup import STATUS_TOPIC, StartupPhase
from im_core.ros import qos
from im_core.ros.coroutines import SOON_S, Alarms, Coroutines, Promise, Work
from im_core.ros.failures import sentence
from im_core.ros.guard import INTERNAL, GuardedNode
from im_core.ros.messages.stamps import wall_stamp
from im_core.ros.parameters import DeclaredParameters
from im_core.text.bounded_json import member
from im_msgs.msg import TaskStatus

#: A task says often where it is until it is ready: who came late to listen shall not hold up the start [s].
STARTING_PERIOD_S = 0.25
#: How often a task that is ready gives a heartbeat [s].
HEARTBEAT_PERIOD_S = 1.0

#: How long the loop may stand still in a start-up phase [s], which waits for others with time limits of its own.
PHASE_STANDSTILL_S = 300.0

INTROSPECTION = {
    "off": ServiceIntrospectionState.OFF,
    "metadata": ServiceIntrospectionState.METADATA,
    "contents": ServiceIntrospectionState.CONTENTS,
}
_READY = int(TaskStatus.READY)


class ManagedNode(GuardedNode):
    """A task of the machine (paper, section 3): loaded, configured and started in step with all others.

    The agent that started the process orders the phases LOAD, CONFIGURE and START through a socket
    (:mod:`im_core.processes.agent_socket`); the node follows, and reports there how far it is. On ``/im/task_status``
    it gives heartbeats to the other nodes. With the parameter ``standalone:=true`` it passes through the phases alone;
    with ``introspection:=metadata`` or ``contents`` all its services publish what they are asked and answer on
    ``<service>/_service_event``, and with ``contents`` its actions goals, results and cancellations.
    Subclasses override :meth:`phase_configure`, :meth:`phase_start` and :meth:`phase_shutdown`.

    Attributes:
        declared: Declares parameters; with a wrong one the node fails to be configured.
        detail: What is told of the task with the phases that it has passed.
        introspection: What its services publish of what they are asked and answer.
        nets: The digests of the nets that the node runs, by name; see :func:`im_core.processes.startup.net_digest`.
        incarnations: The present one of each task, as the agent tells; None where no agent has started this process.
    """

    introspection = ServiceIntrospectionState.OFF

    def __init__(self, name: str, *, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__(name, parameter_overrides=parameter_overrides)
        self.declared = DeclaredParameters(self)
        published = "what services and actions publish of what they carry, on <service>/_service_event"
        self.introspection = INTROSPECTION[
            self.declared.declare("introspection", "off", published, known=INTROSPECTION)
        ]
        self.task_name = self.get_name()
        self.incarnation = secrets.randbits(63)
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._phase = TaskStatus.LOADED
        self.detail = self._detail = ""
        self._stopped = False
        self.alarms = Alarms(self)
        self._wake_timer = self.create_timer(SOON_S, self._woken, clock=self.steady_clock)
        self._wake_timer.cancel()
        self._awake = False
        self._coroutines = Coroutines(self.wake, self._run_task, self._broken)
        self.urgent.add(self._coroutines.step)  # an urgent request may wait for a disk before the answer
        self._status_publisher = self.create_publisher(TaskStatus, STATUS_TOPIC, qos.LATCHED)
        self._heartbeat = self.create_timer(STARTING_PERIOD_S, self._publish_status, clock=self.steady_clock)
        alone = "pass through the start-up phases without a bootstrap"
        self._alone = self.declared.declare("standalone", False, alone)
        if self._alone:
            self.alarms.after(0.0, lambda: self._follow(StartupPhase.START))
        self.nets: dict[str, str] = {}
        self.incarnations: dict[str, TaskIncarnation] | None = None
        self._agent: AgentSocket | None = None
        self._publish_status()

    def create_service(
        self, srv_type: type[Any], srv_name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Service:
        """As of :class:`.GuardedNode`, with introspection as the node's parameter says."""
        service = super().create_service(srv_type, srv_name, callback, **options)
        service.configure_introspection(self.get_clock(), qos.SERVICE_EVENTS, self.introspection)
        return service

    def phase_configure(self) -> None:
        """Load the configuration, open shared resources, start child processes.

        Raises:
            ImError: It cannot be done; the node reports FAILED with the sentence.
        """

    def phase_start(self) -> None:
        """Begin to serve.

        Raises:
            ImError: It cannot be done; the node reports FAILED with the sentence.
        """

    def phase_shutdown(self) -> None:
        """Release everything; called once, regardless of earlier events."""

    @property
    def tells_contents(self) -> bool:
        """Whether services and actions publish all contents carried."""
        return bool(self.introspection == ServiceIntrospectionState.CONTENTS)

    @property
    def ready(self) -> bool:
        """Whether all start-up phases are passed."""
        return bool(self._phase == _READY)

    @property
    def failed(self) -> str:
        """Why the node failed, or an empty string."""
        return self._detail if self._phase == TaskStatus.FAILED else ""

    def fail(self, error: ImError) -> None:
        """Report a failure of the task: the task cannot go on."""
        self._set_phase(TaskStatus.FAILED, error.message)
        self.get_logger().error(error.message)

    def serve(self, agent: AgentSocket) -> None:
        """Report from now on to the agent of the process; call before the node is spun."""
        self._agent, self.incarnations = agent, {}
        self._publish_status()

    def obey(self, order: AgentOrder) -> None:
        """Follow an order of the agent; in the loop.

        Raises:
            DataError: There is no such phase.
        """
        self.incarnations = order.incarnations
        self._follow(member(StartupPhase, order.phase, "the phase that the agent orders"))

    def promise(self) -> Promise:
        """Create a future for coroutines of the node; any thread may complete the future."""
        return Promise(self.wake)

    def spawn(self, work: Work) -> None:
        """Run a coroutine in the loop, from any thread; a coroutine waiting for a promise costs nothing."""
        self._coroutines.spawn(work)

    def begin(self, work: Work) -> None:
        """Run a coroutine at once, until the first wait; from the loop alone."""
        self._coroutines.begin(work)

    def wake(self) -> None:
        """Let the executor look at suspended coroutines soon; from any thread."""
        if not self._awake and rclpy.ok():
            self._awake = True
            with suppress(InvalidHandle):  # the node has ended before what it waited for
                self._wake_timer.reset()

    def shut_down_once(self) -> None:
        """Run :meth:`phase_shutdown` if not run yet."""
        if self._stopped:
            return
        self._stopped = True
        self.standstill_s = PHASE_STANDSTILL_S
        self._phase = TaskStatus.STOPPING
        if rclpy.ok():
            self._publish_status()
        try:
            self.phase_shutdown()
        except Exception as error:  # the process ends all the same
            self.get_logger().error(sentence(error))

    def _woken(self) -> None:
        self._wake_timer.cancel()
        self._awake = False  # before the step: what can go on from now on is not seen by it
        self._coroutines.step()

    def destroy_node(self) -> None:
        """Drop the remaining coroutines."""
        self._coroutines.close()
        destroy: Callable[[], None] = super().destroy_node  # rclpy says no types
        destroy()

    def _run_task(self, work: Coroutine[Any, Any, Any]) -> Task:
        assert self.executor is not None, "coroutines begin in callbacks, which an executor calls"
        return self.executor.create_task(work)

    def _broken(self, error: Exception) -> None:
        self.note_failure("coroutine", error)

    def _follow(self, target: StartupPhase) -> None:
        if target >= StartupPhase.CONFIGURE and self._phase == TaskStatus.LOADED:
            self._run_phase(self._configure, TaskStatus.CONFIGURED)
        if target >= StartupPhase.START and self._phase == TaskStatus.CONFIGURED:
            self._run_phase(self.phase_start, TaskStatus.READY)

    def _configure(self) -> None:
        for configure in (self.phase_configure, self._check_given, dismiss_prepared):
            if self.declared.fault is not None:
                raise self.declared.fault
            configure()

    def _check_given(self) -> None:
        if not self._alone:  # what is given to one that is started by hand may be for another in its process
            self.declared.check_given()

    def _run_phase(self, phase: Callable[[], None], reached: int) -> None:
        usual, self.standstill_s = self.standstill_s, PHASE_STANDSTILL_S
        try:
            phase()
        except ImError as error:
            self.fail(error)
        except Exception as error:  # nobody would know why the task does not get ready
            self.note_failure(f"start-up phase {phase.__name__}", error)
            self.fail(ImError(sentence(error), code=INTERNAL))
        else:
            self._set_phase(reached, self.detail)
        finally:
            self.turn()  # what stood still until now was allowed
            self.standstill_s = usual

    def _set_phase(self, phase: int, detail: str) -> None:
        self._phase, self._detail = phase, detail
        period_s = HEARTBEAT_PERIOD_S if phase == _READY else STARTING_PERIOD_S
        self._heartbeat.timer_period_ns = round(period_s * 1e9)
        if phase == _READY:
            gc.freeze()  # what was loaded and made until now stays: the collector need not go through it again
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
            stamp=wall_stamp(),
        )
        self._status_publisher.publish(message)
        if self._agent is not None:
            waiting = self.open_requests
            self._agent.report(
                TaskReport(
                    self.task_name, self.incarnation, self._phase, self._detail, self.nets,
                    self.turns, len(waiting), waiting.oldest_s(), refused=self.refused,
                )
            )  # fmt: skip
