"""Agent of a host: starts the processes of the host's tasks, restarts dead ones, and stops all in order."""

import math
import os
import signal
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from im_bringup.security.permissions import ENCLAVE_OVERRIDE, enclave_arguments
from im_bringup.tasks.deployment import Deployment, ParameterValue
from im_bringup.tasks.loads import ProcessLoad
from im_bringup.tasks.memory_limit import DEFAULT_MIB, excess, limit_memory, refused
from im_bringup.tasks.middleware import middleware
from im_bringup.tasks.receivers import Receivers
from im_bringup.tasks.standstill import Standstill
from im_core import clock, names
from im_core.config import package_file
from im_core.errors import LinkError
from im_core.executables import path_of
from im_core.files import make_folder, read_text, write_whole
from im_core.patience import Patience
from im_core.processes import agent_socket, scheduling
from im_core.processes import loop_heartbeat as pulse_memory
from im_core.processes.agent_socket import AgentOrder, AgentSocket, TaskReport
from im_core.processes.loop_heartbeat import Pulse
from im_core.processes.process import ChildProcess, await_ends, last_words, may_copy
from im_core.processes.startup import UNPROVED
from im_core.text.yamltext import write_yaml

#: Every process of a machine has this in its environment, with the machine's instance as value.
MARKER = "IM_MACHINE"
RESPAWN_DELAY_S = 1.0
RESPAWN_LIMIT = 5
RESPAWN_WINDOW_S = 60.0

#: Shutdown: how long one process may hold up the next, and all of them together; when the signals get harder [s].
_TURN_S = 0.5
_ALL_TURNS_S = 1.8
_TERM_AFTER_S = 2.6
_KILL_AFTER_S = 3.5

#: How long a task that has failed may take to end before it is killed [s].
_END_S = 4.0


@dataclass(frozen=True)
class ProcessCommand:
    """How a process of the deployment is started.

    Attributes:
        name: Name of the process.
        tasks: Symbolic names of its tasks.
        argv: Program and arguments.
        log: File that takes what it prints.
        memory_mib: How much memory it may have [MiB].
    """

    name: str
    tasks: tuple[str, ...]
    argv: Sequence[str]
    log: Path
    memory_mib: int = DEFAULT_MIB


@dataclass(frozen=True)
class Started:
    """Event: a process was started, together with the tasks in the process."""

    tasks: tuple[str, ...]
    pid: int
    restarts: int

    def __str__(self) -> str:
        return f"{_named(self.tasks)} started{' again' if self.restarts else ''}, process {self.pid}"


@dataclass(frozen=True)
class Died:
    """Event: a process ended without request, together with the tasks in the process.

    Attributes:
        tasks: Names of its tasks.
        sentence: How it ended, its last words, and what follows.
    """

    tasks: tuple[str, ...]
    sentence: str

    def __str__(self) -> str:
        return f"{_named(self.tasks)}: {self.sentence}"


def _named(tasks: tuple[str, ...]) -> str:
    return f"task{'s' if len(tasks) > 1 else ''} {', '.join(tasks)}"


@dataclass
class _Slot:
    command: ProcessCommand
    child: ChildProcess | None = None
    standstill: Standstill | None = None
    receivers: Receivers | None = None
    socket: AgentSocket | None = None
    ordered: str = ""
    log_begin: int = 0
    failure: str = ""
    kill_at: float = math.inf
    restarts: int = 0
    respawn_at: float | None = None
    respawned: deque[float] = field(default_factory=deque)


Spawn = Callable[[ProcessCommand, Mapping[str, str], Sequence[int]], ChildProcess]


def spawn_process(command: ProcessCommand, environment: Mapping[str, str], inherit: Sequence[int]) -> ChildProcess:
    """Start a process; the death of the starting thread requests the end of the process.

    Where it may, it begins as a copy of this one.

    Args:
        command: How it is started.
        environment: Its environment.
        inherit: File descriptors that it gets; the environment says what they are.
    """
    child = ChildProcess(
        command.argv,
        name=command.name,
        log=command.log,
        environment=environment,
        death_signal=signal.SIGTERM,
        inherit=inherit,
        copied=may_copy(command.argv[0]),
    )
    limit_memory(command.memory_mib, child.pid)
    return child


class Agent:
    """Processes of one host; call :meth:`poll` often, from the thread of the call of :meth:`start`.

    Args:
        commands: One for each process, in starting order.
        environment: Environment of the processes.
        spawn: Starts a process.
    """

    def __init__(
        self, commands: Sequence[ProcessCommand], environment: Mapping[str, str], spawn: Spawn = spawn_process
    ) -> None:
        self._slots = [_Slot(command) for command in commands]
        #: Environment of the processes that are started from now on.
        self.environment = dict(environment)
        self._spawn = spawn
        #: Whether a process that died is started again.
        self.respawn = False
        self._order = ""
        self._usage = ProcessLoad()

    def start(self) -> list[Started]:
        """Start all processes.

        Raises:
            LinkError: One cannot be started.
        """
        return [self._start(slot) for slot in self._slots]

    def poll(self, now: float) -> list[Started | Died]:
        """Notice ended processes, end processes with a fault (stuck, too much memory), and restart the due ones.

        Args:
            now: Monotonic time [s].
        """
        events: list[Started | Died] = []
        for slot in self._slots:
            self._tell(slot)
            if slot.child is not None and (code := slot.child.poll()) is not None:
                slot.child = None
                events.append(Died(slot.command.tasks, self._plan(slot, code, now)))
                slot.failure, slot.kill_at = "", math.inf
            elif slot.child is not None and now >= slot.kill_at:
                slot.child.send_signal(signal.SIGKILL)
            elif slot.child is not None and not slot.failure and (fault := _fault(slot, now)):
                slot.failure, slot.kill_at = f"{fault}; where, is in its log", now + _END_S
                slot.child.send_signal(signal.SIGABRT)  # writes the stacks of its threads, whoever holds what
            elif slot.respawn_at is not None and now >= slot.respawn_at:
                slot.respawn_at = None
                slot.restarts += 1
                slot.respawned.append(now)
                try:
                    events.append(self._start(slot))
                except LinkError as error:  # no room for its log, no process left: that may pass
                    slot.respawn_at = now + RESPAWN_DELAY_S
                    events.append(Died(slot.command.tasks, f"{error.message}; tried again in {RESPAWN_DELAY_S:g} s"))
        return events

    def order(self, order: AgentOrder) -> None:
        """Pass an order to all processes, also to processes started later; the last order counts."""
        self._order = order.text()
        for slot in self._slots:
            self._tell(slot)

    def reports(self) -> list[tuple[TaskReport, int]]:
        """Return all task reports of the host since the last call, each with the process.

        Raises:
            DataError: A report makes no sense.
        """
        self._usage.look([slot.child.pid for slot in self._slots if slot.child is not None], clock.monotonic())
        return [
            (self._usage.told(report, slot.child.pid), slot.child.pid)
            for slot in self._slots
            if slot.socket is not None and slot.child is not None
            for report in slot.socket.reports()
            if report.task in slot.command.tasks
        ]

    def replace(self, name: str, pid: int, failure: str, now: float) -> None:
        """End the process of a task after a report of failure by the task, if the local host runs the task.

        It is started again as if it had died. Before the machine was ready (:attr:`respawn`) nothing is ended: the
        start fails, and says why.

        Args:
            name: Task.
            pid: The process that says so; one that was replaced already changes nothing.
            failure: Why it cannot go on.
            now: Monotonic time [s].
        """
        slot = next((slot for slot in self._slots if name in slot.command.tasks), None)
        if slot is None or slot.child is None or slot.child.pid != pid or slot.failure or not self.respawn:
            return
        slot.failure, slot.kill_at = failure or "it gave no reason", now + _END_S
        slot.child.send_signal(signal.SIGTERM)

    def running(self) -> list[str]:
        """Return the names of the tasks with a running process, in starting order."""
        up = [slot.command.tasks for slot in self._slots if slot.child is not None and slot.child.poll() is None]
        return [task for tasks in up for task in tasks]

    def shut_down(self) -> list[str]:
        """Stop all processes, the last started first; takes less than 4 s, except for waits for a processor.

        Each gets SIGINT when its turn comes, which is when the one before it has ended or has had its share of 1.8 s.
        Who has not ended after 2.6 s gets SIGTERM, after 3.5 s SIGKILL, counted as :class:`im_core.patience.Patience`
        does.

        Returns:
            Names of the processes that had to be killed.
        """
        self.respawn = False
        for slot in self._slots:
            slot.respawn_at = None
        children = [(slot.command.name, slot.child) for slot in self._slots if slot.child is not None]
        turn = min(_TURN_S, _ALL_TURNS_S / max(1, len(children)))
        everyone = [child for _, child in children]
        patience = Patience(child.pid for child in everyone)
        for child in reversed(everyone):
            child.send_signal(signal.SIGINT)
            await_ends([child], patience, patience.look() + turn)
        await_ends(everyone, patience, _TERM_AFTER_S)
        for child in everyone:
            child.send_signal(signal.SIGTERM)
        await_ends(everyone, patience, _KILL_AFTER_S)
        killed = [name for name, child in children if child.poll() is None]
        for child in everyone:
            child.send_signal(signal.SIGKILL)
        await_ends(everyone, patience, _KILL_AFTER_S + 0.4)
        return killed

    def _start(self, slot: _Slot) -> Started:
        slot.log_begin = _size(slot.command.log)
        try:
            with ExitStack() as of_child:
                pulse = Pulse.create()
                of_child.callback(pulse.keep)
                ours, descriptor = AgentSocket.pair()
                of_child.callback(os.close, descriptor)
                if slot.socket is not None:
                    slot.socket.close()
                slot.socket, inherit = ours, [pulse.descriptor, descriptor]
                given = {pulse_memory.VARIABLE: str(pulse.descriptor), agent_socket.VARIABLE: str(descriptor)}
                slot.child = self._spawn(slot.command, {**self.environment, **given}, inherit)
        except OSError as error:
            raise LinkError(f"{_named(slot.command.tasks)} cannot be started: {error}") from error
        slot.standstill, slot.ordered = Standstill(slot.child.pid, pulse), ""
        slot.receivers = Receivers(slot.child.pid)
        self._tell(slot)
        return Started(slot.command.tasks, slot.child.pid, slot.restarts)

    def _tell(self, slot: _Slot) -> None:
        """Send a process the pending order; if the socket is full, try again at the next poll."""
        if slot.child is None or slot.socket is None or slot.ordered == self._order:
            return
        if slot.socket.send(self._order):
            slot.ordered = self._order

    def _plan(self, slot: _Slot, code: int, now: float) -> str:
        sentence = f"it {_ending(slot, code)} (log: {slot.command.log})"
        if not self.respawn:
            return sentence
        while slot.respawned and now - slot.respawned[0] > RESPAWN_WINDOW_S:
            slot.respawned.popleft()
        if len(slot.respawned) >= RESPAWN_LIMIT:
            return f"{sentence}; it was started again {RESPAWN_LIMIT} times within a minute and is given up"
        slot.respawn_at = now + RESPAWN_DELAY_S
        return f"{sentence}; it is started again in {RESPAWN_DELAY_S:g} s"


def _fault(slot: _Slot, now: float) -> str:
    """Return the reason to end a running process, as a clause; empty if there is none."""
    if slot.child is None or slot.standstill is None or slot.receivers is None:
        return ""
    hang = slot.standstill.found(now) or slot.receivers.found(now)
    return hang or excess(slot.child.pid, slot.command.memory_mib)


def _ending(slot: _Slot, code: int) -> str:
    """Return how a task ended; with the last words, unless the task was killed without time for any."""
    if slot.failure:
        return f"failed: {slot.failure}"
    if code == -signal.SIGKILL:
        return "was killed by SIGKILL"
    if refused(code, slot.command.log, slot.log_begin):
        return f"ended: it asked for more memory than its limit of {slot.command.memory_mib} MiB"
    words = last_words(slot.command.log, slot.log_begin)
    how = f"ended with exit code {code}" if code >= 0 else f"was killed by {signal.Signals(-code).name}"
    return f"{how}{': ' + words if words else ''}"


def _size(log: Path) -> int:
    return log.stat().st_size if log.exists() else 0


def commands(deployment: Deployment, host: str, run_dir: Path) -> list[ProcessCommand]:
    """Return the commands for the processes of one host, in starting order; write the tasks' parameter files.

    Args:
        deployment: The deployment.
        host: Name of the host in it.
        run_dir: Folder for parameter files and logs.

    Raises:
        NotFoundError: The host, a package or an executable does not exist.
        StoreError: A parameter file cannot be written.
    """
    result = []
    for process, placed in deployment.on_host(host).items():
        programs = [path_of(each.task.package, each.task.executable) for each in placed]
        argv = [str(programs[0])]
        if len(placed) > 1:
            shared = [f"{each.task.package}/{each.task.executable}" for each in placed]
            argv = [str(path_of("im_bringup", "shared_process")), *shared]
        parameters = {each.task.node: deployment.parameters_of(each.task) for each in placed}
        file = write_parameters(run_dir, process, parameters)
        argv += [*enclave_arguments(host, process), "--disable-external-lib-logs"]
        for each in placed:
            if each.name != each.task.executable:  # the name that its node has by itself
                argv += ["-r", f"{each.task.executable}:__node:={each.name}"]
        argv += ["--params-file", str(file)]
        tasks = tuple(each.name for each in placed)
        log = run_dir / "log" / f"{process}.log"
        result.append(ProcessCommand(process, tasks, argv, log, deployment.memory_mib))
    return result


def write_parameters(run_dir: Path, process: str, parameters: Mapping[str, Mapping[str, ParameterValue]]) -> Path:
    """Write the ROS parameter file of a process.

    Args:
        run_dir: Folder of the machine.
        process: Name of the process.
        parameters: Those of each of its nodes, by its fully qualified name.

    Raises:
        StoreError: It cannot be written.
    """
    path = run_dir / "parameters" / f"{process}.yaml"
    make_folder(path.parent)
    content = {node: {"ros__parameters": dict(values)} for node, values in parameters.items()}
    return write_whole(path, write_yaml(content))


def defaults() -> dict[str, str]:
    """Return the variables that a sourced workspace does not set; ``scripts/lib.sh`` sets them for tools."""
    lines = read_text(package_file("im_bringup", "config/environment.txt")).splitlines()
    return dict(line.split("=", 1) for line in lines if not line.startswith("#"))


def environment(base: Mapping[str, str], run_dir: Path, deployment: Deployment) -> dict[str, str]:
    """Return the environment of the machine's processes: mark, folder, cell, DDS, servo core, proof required."""
    core = scheduling.reserve() if deployment.clock_factor > 0.0 else {}
    dds, unproved = middleware(base, deployment), str(int(deployment.unproved))
    given = {**defaults(), "ROS_LOG_DIR": str(run_dir / "ros")}
    cell = {names.CELL: deployment.cell} if deployment.cell else {}
    own = {MARKER: names.instance(), "IM_RUN_DIR": str(run_dir), UNPROVED: unproved}
    started = {name: value for name, value in base.items() if name != ENCLAVE_OVERRIDE}  # that is of clients
    return {**given, **started, **core, **dds, **cell, **own}
