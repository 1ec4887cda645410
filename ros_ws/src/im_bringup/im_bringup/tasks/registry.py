"""Task identification (paper, section 3): unique id, symbolic name, place and progress of every task."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntEnum

from im_bringup.tasks.deployment import PlacedTask
from im_core.errors import NotFoundError
from im_core.processes.agent_socket import TaskIncarnation

#: A host whose agent reports nothing for longer is taken for dead, with its tasks [s].
SILENCE_S = 6.0


class Progress(IntEnum):
    """Progress of a task; the first values as in ``im_msgs/msg/TaskStatus``."""

    STARTING = -1
    LOADED = 0
    CONFIGURED = 1
    READY = 2
    STOPPING = 3
    FAILED = 4
    DEAD = 5

    @property
    def word(self) -> str:
        """Word for the progress in messages."""
        return self.name.lower()


@dataclass(frozen=True)
class TaskRecord:
    """Known state of a task.

    Attributes:
        placed: Id, name, host, process and executable, from the deployment.
        pid: Process id, 0 if it never ran.
        incarnation: Number the task drew when it started, 0 if it was not heard yet.
        restarts: How often it was started again.
        progress: How far it is.
        detail: Why it failed or died, or empty.
    """

    placed: PlacedTask
    pid: int = 0
    incarnation: int = 0
    restarts: int = 0
    progress: Progress = Progress.STARTING
    detail: str = ""

    @property
    def name(self) -> str:
        """Symbolic name."""
        return self.placed.name


class Registry:
    """Records of all tasks of a machine.

    Args:
        tasks: The tasks of the deployment.
        local_host: Host whose processes are watched directly; the others are known by what their agents report.
    """

    def __init__(self, tasks: Iterable[PlacedTask], local_host: str) -> None:
        self._records = {placed.name: TaskRecord(placed) for placed in tasks}
        self._local_host = local_host
        self._agents: dict[str, float] = {}  # when the agent of each other host was heard last

    def records(self) -> list[TaskRecord]:
        """All records, in starting order."""
        return list(self._records.values())

    def find(self, name: str) -> TaskRecord:
        """Return the record of a task, given the symbolic name.

        Raises:
            NotFoundError: No task has this name; the message lists those that exist.
        """
        if name not in self._records:
            raise NotFoundError(kind="task", name=name, known=self._records)
        return self._records[name]

    def started(self, name: str, pid: int, restarts: int) -> None:
        """Record the start of a task's process on the local host."""
        record = self.find(name)
        self._records[name] = TaskRecord(record.placed, pid=pid, restarts=restarts)

    def died(self, name: str, detail: str) -> None:
        """The process of the task ended."""
        self._records[name] = replace(self.find(name), progress=Progress.DEAD, detail=detail)

    def heard(self, name: str, pid: int, incarnation: int, progress: Progress, detail: str) -> bool:
        """Record a report of a task.

        Args:
            name: Task that sent it.
            pid: Its process.
            incarnation: Number it drew when it started.
            progress: How far it is.
            detail: Why it failed, or empty.

        Returns:
            Whether the record changed. Reports of unknown tasks, and late ones of processes that were replaced, change
            nothing.
        """
        record = self._records.get(name)
        if record is None:
            return False
        local = record.placed.host == self._local_host
        if local and (pid != record.pid or record.progress is Progress.DEAD):
            return False
        again = bool(record.incarnation) and incarnation != record.incarnation
        restarts = record.restarts + (1 if again and not local else 0)
        new = TaskRecord(record.placed, pid, incarnation, restarts, progress, detail)
        self._records[name] = new
        return new != record

    def incarnations(self, host: str) -> dict[str, TaskIncarnation]:
        """Return the present incarnations of all tasks, in the form for the agent of a host."""
        return {
            record.name: TaskIncarnation(
                record.incarnation,
                record.pid if record.placed.host == host else 0,
                record.progress in (Progress.LOADED, Progress.CONFIGURED),
            )
            for record in self.records()
        }

    def agent_heard(self, host: str, now: float) -> None:
        """Note a report of the agent of another host, at a monotonic time [s]."""
        self._agents[host] = now

    def silence(self, now: float) -> list[TaskRecord]:
        """Mark the tasks of hosts with a silent agent as dead.

        A task may be silent for long while its agent lives: the agent knows the deaths of its own tasks.

        Args:
            now: Monotonic time [s].

        Returns:
            The records that changed.
        """
        changed = []
        for host, heard in self._agents.items():
            if now - heard <= SILENCE_S:
                continue
            sentence = (
                f"nothing was heard of host {host} for {now - heard:.1f} s; its agent has ended, or the network between"
                " the hosts is cut"
            )
            for record in self.records():
                if record.placed.host == host and record.progress is not Progress.DEAD:
                    self.died(record.name, sentence)
                    changed.append(self.find(record.name))
        return changed
