"""Node ``/bootstrap``: starts a deployment's tasks phase by phase, knows tasks by name, stops tasks in order."""

import os
import threading
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.subscription import Subscription
from std_msgs.msg import UInt8

from im_bringup.machine import machine_state as machine
from im_bringup.machine import run_state
from im_bringup.machine.bootstrap import Bootstrap
from im_bringup.machine.machine_state import MachineRecord
from im_bringup.machine.nets import MachineNets
from im_bringup.ros.agents import ACKNOWLEDGED_S, RemoteAgents
from im_bringup.ros.shared_names import LOOK_S, SharedNames
from im_bringup.security.permissions import BOOTSTRAP, enclave_arguments
from im_bringup.tasks.agent import Died
from im_bringup.tasks.deployment import Deployment, options_text
from im_bringup.tasks.loads import Load
from im_bringup.tasks.registry import Progress, TaskRecord
from im_bringup.tasks.upkeep import Upkeep
from im_core import clock, names
from im_core.errors import ImError, StoreError
from im_core.processes.process import dismiss_prepared
from im_core.processes.procfs import ProcessId
from im_core.processes.startup import PHASE_TOPIC, STATUS_TOPIC, StartupPhase
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_core.ros.messages.stamps import wall_stamp
from im_core.ros.parameters import describe_sim_time
from im_core.ros.repeated_warnings import Reminders
from im_core.ros.run import main as spin
from im_msgs.msg import NetDescription, TaskRegistry, TaskStatus
from im_msgs.msg import TaskRecord as TaskRecordMessage
from im_msgs.srv import QueryTask

#: How often the load of the tasks is told [s], and where.
LOADS_S, LOADS_TOPIC = 2.0, "/bootstrap/loads"
#: How often the bootstrap looks at its processes while they start, and when the machine is ready [s].
STARTING_PERIOD_S, POLL_PERIOD_S = 0.05, 0.2


class BootstrapNode(GuardedNode):
    """ROS shell of :class:`im_bringup.machine.bootstrap.Bootstrap`; translates messages, decides nothing.

    Args:
        deployment: What is started.
        path: The file it came from.
        nets: Finds out whether the nets of its tasks may run together.
        bootstrap: Has started the processes of this host.
        secret: What the hosts of the deployment share; empty for one host.
    """

    def __init__(
        self, deployment: Deployment, path: Path, nets: MachineNets, bootstrap: Bootstrap, secret: bytes
    ) -> None:
        super().__init__("bootstrap")
        describe_sim_time(self)
        self.log: RcutilsLogger = self.get_logger()
        self._deployment, self._path = deployment, path
        self._run_dir = names.run_dir().resolve()
        self._nets, self._bootstrap = nets, bootstrap
        self._reminders = Reminders(self)
        spared = [Path(deployment.calibration)] if deployment.calibration else []
        self._upkeep = Upkeep(self._run_dir, names.results_dir(), deployment.keep, spared, self.log.warning)
        self._process = ProcessId.current()
        self._trouble = ""
        self._descriptions: Subscription | None = None
        self._written: MachineRecord | None = None
        self._phase_publisher = self.create_publisher(UInt8, PHASE_TOPIC, qos.LATCHED)
        self._tasks_publisher = self.create_publisher(TaskRegistry, "/bootstrap/tasks", qos.LATCHED)
        self._loads_publisher = self.create_publisher(DiagnosticArray, LOADS_TOPIC, qos.LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
        self.create_subscription(TaskStatus, STATUS_TOPIC, self._status, qos.STATUS)
        service = self.create_service(QueryTask, "/bootstrap/query_task", self._query)
        service.configure_introspection(self.get_clock(), qos.SERVICE_EVENTS, ServiceIntrospectionState.CONTENTS)
        others = [host for host in deployment.hosts if host != deployment.local_host()]
        self._agents = RemoteAgents(self, bootstrap, others, options_text(deployment), secret)
        served = {placed.task.node for placed in deployment.tasks()} | {self.get_fully_qualified_name()}
        self._shared_names = SharedNames(self, served)
        self._announce(StartupPhase.LOAD)
        self._upkeep.start()
        self._show()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._poll_timer = self.create_timer(STARTING_PERIOD_S, self._poll, clock=steady)
        self._names_timer = self.create_timer(LOOK_S, self._look_at_names, clock=steady)
        self._loads_timer = self.create_timer(LOADS_S, self._tell_loads, clock=steady)

    def shut_down(self) -> None:
        """Stop all tasks, the last started first; then send a stop to other hosts."""
        self._upkeep.stop()
        self._write_record(machine.STOPPING)
        for name in self._bootstrap.shut_down():
            self.log.warning(f"process {name} did not end and was killed")
        self._announce(StartupPhase.SHUTDOWN)
        self._agents.order()
        if not self._agents.acknowledged():
            self.log.warning(f"not every agent has heard within {ACKNOWLEDGED_S:g} s that the machine ends")
        machine.remove()

    def _poll(self) -> None:
        before, state = self._bootstrap.phase, self._bootstrap.state
        events = self._bootstrap.poll(clock.monotonic())
        if self._bootstrap.state == machine.READY != state:
            threading.Thread(target=self._note_alive, name="alive", daemon=True).start()  # the disk may hang
        for event in events:
            if isinstance(event, Died):
                self.log.error(str(event))
            else:
                self.log.info(str(event))
        if self._bootstrap.phase is not before:
            if self._bootstrap.phase is StartupPhase.START:
                self._say_verdict()
            self._announce(self._bootstrap.phase)
        self._agents.order()
        if self._bootstrap.awaits_nets and self._descriptions is None:  # what was described before their digests came
            self._descriptions = self.create_subscription(
                NetDescription, "/pnt/nets", self._described, qos.LATCHED_NETS
            )
        if self._bootstrap.changed() or events or self._trouble:
            self._show()
            if self._bootstrap.state == machine.READY:
                self._poll_timer.timer_period_ns = round(POLL_PERIOD_S * 1e9)
                dismiss_prepared()

    def _look_at_names(self) -> None:
        if self._shared_names.look():
            for sentence in self._shared_names.sentences.values():
                self.log.warning(sentence)
            self._show()

    def _tell_loads(self) -> None:
        records = self._bootstrap.registry.records()
        statuses = [load_status(record, self._bootstrap.loads.of(record.name)) for record in records]
        message = DiagnosticArray(status=statuses)
        message.header.stamp = wall_stamp()
        self._loads_publisher.publish(message)
        self._diagnostics.publish(message)

    def _note_alive(self) -> None:
        try:
            run_state.begin(self._run_dir, os.environ.get(names.RUN, ""))
        except StoreError as error:  # what runs goes on
            self.log.error(error.message)

    def _described(self, message: NetDescription) -> None:
        self._nets.described(message.node, message.net, message.json)

    def _status(self, message: TaskStatus) -> None:
        self._bootstrap.seen(message.name, message.incarnation)

    def _query(self, request: QueryTask.Request, response: QueryTask.Response) -> QueryTask.Response:
        try:
            response.task = self._told(self._bootstrap.registry.find(request.name))
        except ImError as error:
            response.success, response.message = False, error.message
            return response
        response.success = True
        return response

    def _say_verdict(self) -> None:
        if not self._nets.proved:
            self._reminders.add("nets", self._nets.verdict)
        elif self._nets.verdict:
            self.log.info(self._nets.verdict)

    def _announce(self, phase: StartupPhase) -> None:
        self._phase_publisher.publish(UInt8(data=int(phase)))
        self.log.info(f"phase {phase.name}")

    def _show(self) -> None:
        tasks = [self._told(record) for record in self._bootstrap.registry.records()]
        self._tasks_publisher.publish(TaskRegistry(stamp=wall_stamp(), tasks=tasks))
        self._write_record(self._bootstrap.state)

    def _told(self, record: TaskRecord) -> TaskRecordMessage:
        message = to_message(record)
        doubt = self._shared_names.sentences.get(message.node, "")
        message.detail = "; ".join(part for part in (message.detail, doubt) if part)
        return message

    def _write_record(self, state: str) -> None:
        records = self._bootstrap.registry.records()
        record = MachineRecord(
            pid=self._process.pid,
            start=self._process.start,
            state=state,
            phase=self._bootstrap.phase.name,
            tasks=len(records),
            run_dir=str(self._run_dir),
            deployment=str(self._path),
            clock_factor=self._deployment.clock_factor,
            seed=self._deployment.seed,
            port=self._deployment.port,
            missing=self._bootstrap.missing(),
            nets=self._nets.verdict,
            refused=bool(self._nets.failure),
            incarnations={record.name: record.incarnation for record in records if record.incarnation},
            took={part: round(seconds, 3) for part, seconds in self._bootstrap.took.items()},
        )
        if record == self._written:
            return
        try:
            machine.write(record)
        except StoreError as error:  # tried again with the next look; what runs goes on
            if error.message != self._trouble:
                self._trouble = error.message
                self.log.error(error.message)
            return
        self._trouble, self._written = "", record


def to_message(record: TaskRecord) -> TaskRecordMessage:
    """The message of a record."""
    placed = record.placed
    return TaskRecordMessage(
        id=placed.id,
        name=placed.name,
        node=placed.task.node,
        host=placed.host,
        process=placed.process,
        package=placed.task.package,
        executable=placed.task.executable,
        pid=record.pid,
        incarnation=record.incarnation,
        restarts=record.restarts,
        phase=record.progress.word,
        detail=record.detail,
    )


def load_status(record: TaskRecord, load: Load) -> DiagnosticStatus:
    """Return the load of a task as a diagnostic status: ERROR if the task has failed or died."""
    bad = record.progress in (Progress.FAILED, Progress.DEAD)
    values = {
        "callbacks_per_s": f"{load.rate:.1f}",
        "open_requests": load.requests,
        "oldest_request_s": f"{load.oldest_s:.1f}",
        "refused_requests": load.refused,
        "process_cpu": f"{load.cpu:.3f}",
        "process_memory_mib": f"{load.memory_mib:.1f}",
    }
    return DiagnosticStatus(
        level=DiagnosticStatus.ERROR if bad else DiagnosticStatus.OK,
        name=f"tasks: {record.name}",
        hardware_id=record.placed.host,
        message=f"{record.progress.word}{': ' + record.detail if record.detail else ''}",
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )


def run(deployment: Deployment, path: Path, nets: MachineNets, bootstrap: Bootstrap, secret: bytes) -> int:
    """Run ``/bootstrap`` until SIGINT or SIGTERM, with the arguments of the node; return the exit code."""
    node = partial(BootstrapNode, deployment, path, nets, bootstrap, secret)
    enclave = enclave_arguments(deployment.local_host(), BOOTSTRAP)
    return spin(node, args=enclave, at_end=BootstrapNode.shut_down)
