"""Load of tasks and processes, as measured between two reports."""

from collections.abc import Collection
from dataclasses import dataclass, replace

from im_core.processes.agent_socket import TaskReport
from im_core.processes.procfs import cpu_of, families, private_bytes

#: How often the agent of a host measures its processes [s].
LOOK_S = 2.0


@dataclass(frozen=True)
class Load:
    """Load of a task between two reports.

    Attributes:
        rate: Callbacks a second.
        requests: How many requests of its services wait for an answer.
        oldest_s: Age of the oldest of them [s].
        cpu: Share of one processor that its process and the children of that use; 1.0: all of one.
        memory_mib: Their private memory [MiB].
        refused: How many requests of its services were answered without success, since its start.
    """

    rate: float = 0.0
    requests: int = 0
    oldest_s: float = 0.0
    cpu: float = 0.0
    memory_mib: float = 0.0
    refused: int = 0


class ProcessLoad:
    """CPU time and memory of processes and descendants, measured at most every :data:`LOOK_S`."""

    def __init__(self) -> None:
        self._look_at = 0.0
        self._found: dict[int, tuple[float, float]] = {}

    def look(self, pids: Collection[int], now: float) -> None:
        """Measure the processes, if due.

        Args:
            pids: The processes.
            now: Monotonic time [s].
        """
        if now < self._look_at:
            return
        self._look_at = now + LOOK_S
        self._found = {
            root: (sum(map(cpu_of, family)), sum(map(private_bytes, family)) / 2**20)
            for root, family in families(pids).items()
        }

    def told(self, report: TaskReport, pid: int) -> TaskReport:
        """Return a report with the usage of the process."""
        cpu_s, memory_mib = self._found.get(pid, (0.0, 0.0))
        return replace(report, cpu_s=cpu_s, memory_mib=memory_mib)


class TaskLoads:
    """Loads of all tasks, from reports."""

    def __init__(self) -> None:
        self._base: dict[str, tuple[float, TaskReport]] = {}
        self._loads: dict[str, Load] = {}

    def note(self, report: TaskReport, now: float) -> None:
        """Take a report; rates are measured over at least :data:`LOOK_S`.

        Args:
            report: The report.
            now: When it came, monotonic time [s].
        """
        begun, base = self._base.get(report.task, (now, report))
        load = self._loads.get(report.task, Load())
        if base.incarnation != report.incarnation:
            begun, base, load = now, report, Load()
        if now - begun >= LOOK_S:
            rate = (report.turns - base.turns) / (now - begun)
            load = replace(load, rate=rate, cpu=max(0.0, report.cpu_s - base.cpu_s) / (now - begun))
            begun, base = now, report
        self._base[report.task] = begun, base
        self._loads[report.task] = replace(
            load,
            requests=report.requests,
            oldest_s=report.oldest_s,
            memory_mib=report.memory_mib,
            refused=report.refused,
        )

    def of(self, task: str) -> Load:
        """Return the load of a task; zeros before the first report."""
        return self._loads.get(task, Load())
