"""Bootstrap (paper, section 3): leads all tasks of a deployment through the start-up phases, then watches all.

No task enters a phase before all tasks have finished the one before.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

from im_bringup.machine import machine_state as machine
from im_bringup.machine.nets import MachineNets
from im_bringup.tasks.agent import Agent, Died, Started
from im_bringup.tasks.deployment import PlacedTask
from im_bringup.tasks.host_digest import differences
from im_bringup.tasks.loads import TaskLoads
from im_bringup.tasks.registry import Progress, Registry, TaskRecord
from im_core.errors import NotFoundError
from im_core.patience import Silence
from im_core.processes.agent_socket import AgentOrder, TaskReport
from im_core.processes.startup import StartupPhase
from im_core.text.bounded_json import member

#: A task of this host that was ready and is silent for longer is started again [s].
SILENCE_S = 30.0
#: How often the silence of tasks is looked at, and for how much of it a pause between two looks counts at most [s].
_LOOK_S, _LONGEST_PAUSE_S = 0.25, 0.5

#: How far a task must be for its part of a phase to be done.
_DONE = {
    StartupPhase.LOAD: Progress.LOADED,
    StartupPhase.CONFIGURE: Progress.CONFIGURED,
    StartupPhase.START: Progress.READY,
}
#: The part of the start between CONFIGURE and START: whether the nets may run together.
PROOF = "nets"
_WORDS = {StartupPhase.LOAD: "loaded", StartupPhase.CONFIGURE: "configured", StartupPhase.START: "ready"}


def done(phase: StartupPhase, records: Iterable[TaskRecord]) -> bool:
    """Whether all tasks have finished a phase."""
    return all(_finished(phase, record) for record in records)


def next_phase(phase: StartupPhase, records: Sequence[TaskRecord]) -> StartupPhase:
    """Return the phase the machine may enter: the next one if all tasks have finished the present one."""
    if phase < StartupPhase.START and done(phase, records):
        return StartupPhase(phase + 1)
    return phase


def missing(phase: StartupPhase, records: Iterable[TaskRecord]) -> list[str]:
    """Return one sentence for each task with an unfinished phase: name, present phase, and reason if reported."""
    sentences = []
    for record in records:
        if _finished(phase, record):
            continue
        if record.progress is Progress.FAILED:
            sentences.append(f"{record.name} failed: {record.detail}")
        elif record.progress is Progress.DEAD:
            sentences.append(f"{record.name} died: {record.detail}")
        else:
            sentences.append(f"{record.name} is {record.progress.word}, not {_WORDS[phase]}")
    return sentences


def broken(records: Iterable[TaskRecord]) -> list[TaskRecord]:
    """Return the failed or dead tasks, unable to go on without help."""
    return [record for record in records if record.progress in (Progress.FAILED, Progress.DEAD)]


def _finished(phase: StartupPhase, record: TaskRecord) -> bool:
    if phase is StartupPhase.SHUTDOWN:
        return record.progress is Progress.DEAD
    return _DONE[phase] <= record.progress <= Progress.READY


class SilentTasks:
    """Detector of silent tasks: maybe still running, but without arriving messages.

    Silence counts as in :class:`im_core.patience.Silence`: neither while this process does not listen itself, nor while
    a task of this host waits for a processor.
    """

    def __init__(self) -> None:
        self._silences: dict[tuple[str, int], Silence] = {}
        self._look_at = -math.inf

    def heard(self, name: str, pid: int, progress: Progress) -> None:
        """Note a heartbeat of a task; a task may be silent for long before "ready", and fall silent after."""
        for other in [known for known in self._silences if known[0] == name]:
            del self._silences[other]
        if progress is Progress.READY:
            self._silences[name, pid] = Silence(pid, longest_look_s=_LONGEST_PAUSE_S)

    def found(self, now: float) -> list[tuple[str, int]]:
        """Return task and process of the tasks fallen silent since the last call; each is reported once.

        Args:
            now: Monotonic time [s].
        """
        if now < self._look_at:
            return []
        self._look_at = now + _LOOK_S
        silent = [task for task, silence in self._silences.items() if silence.look() > SILENCE_S]
        for task in silent:
            del self._silences[task]
        return silent


class Bootstrap:
    """Decides in which phase the machine is.

    A task that fails or dies before the machine was ready makes the start fail. One that does so later is started
    again and passes through the phases alone.

    Args:
        tasks: All tasks of the deployment.
        agent: Agent of this host.
        host: Name of this host in the deployment.
        nets: Finds out whether the nets of the tasks may run together, before START.
        digests: Of this host; empty for a deployment on one host.
    """

    def __init__(
        self,
        tasks: Sequence[PlacedTask],
        agent: Agent,
        host: str,
        nets: MachineNets,
        digests: Mapping[str, str] | None = None,
    ) -> None:
        self.registry = Registry(tasks, host)
        self.loads = TaskLoads()
        self.phase = StartupPhase.LOAD
        self.state = machine.STARTING
        self._agent, self._host, self._nets = agent, host, nets
        self._digests = digests or {}
        self._unlike: dict[str, str] = {}  # sentence on each host with other files, or of another machine
        #: Hosts whose agents were not heard, each with what is wrong with what was.
        self._unheard = {
            each: f"no agent was heard; on it: start.sh FILE --host {each}"
            for each in {placed.host for placed in tasks} - {host}
        }
        self._silence = SilentTasks()
        self._changed = True
        #: How long the parts of the start have taken, in their order [s].
        self.took: dict[str, float] = {}
        self._part_began = 0.0

    def start(self, now: float) -> None:
        """Start the processes of the local host, at a monotonic time [s]."""
        self._part_began = now
        for event in self._agent.start():
            self._note(event)

    def heard(self, name: str, pid: int, incarnation: int, progress: Progress, detail: str, now: float) -> None:
        """Take the report of a task, at a monotonic time [s]; see :meth:`im_bringup.tasks.registry.Registry.heard`."""
        if self.registry.heard(name, pid, incarnation, progress, detail):
            self._changed = True
            self._silence.heard(name, pid, progress)
            if progress is Progress.FAILED:
                self._agent.replace(name, pid, detail, now)

    def reported(self, report: TaskReport, pid: int, host: str, now: float) -> None:
        """Take a task report forwarded by the agent of a host.

        Args:
            report: It.
            pid: Process of the task.
            host: The host; a report of a task of another host does not count.
            now: Monotonic time [s].

        Raises:
            NotFoundError: There is no such task.
            DataError: There is no such phase.
        """
        placed = self.registry.find(report.task).placed
        progress = member(Progress, report.phase, f"the phase of task {report.task}")
        if placed.host == host:
            self._nets.reported(placed.task.node, report.nets)
            self.loads.note(report, now)
            self.heard(report.task, pid, report.incarnation, progress, report.detail, now)

    def agent_heard(self, host: str, digests: Mapping[str, str], now: float, serves: str = "") -> str:
        """Note a report of the agent of a host; return the reason why the agent gets no orders, as a sentence.

        The reason is other files than those of this host, or another machine; before the machine was ready the start
        fails.

        Args:
            host: The host.
            digests: Of the host.
            now: Monotonic time [s].
            serves: Run of another machine, for which the agent works; empty if there is none.
        """
        self.registry.agent_heard(host, now)
        self._changed |= host in self._unheard
        self._unheard.pop(host, None)
        unlike = differences(self._digests, digests)
        sentence = ""
        if serves:
            sentence = (
                f"the agent of host {host} works for a machine of the same ROS domain on another host (run {serves}); "
                "stop that machine, or set another ROS_DOMAIN_ID"
            )
        elif unlike:
            sentence = f"host {host} differs from host {self._host} in: {', '.join(unlike)}; give both the same files"
        self._changed |= sentence != self._unlike.get(host, "")
        if sentence:
            self._unlike[host] = sentence
        else:
            self._unlike.pop(host, None)
        return sentence

    def stranger_heard(self, host: str, sentence: str) -> None:
        """Note a message by a stranger to the agents; a start without an agent of the host names the message."""
        if host in self._unheard:
            self._changed |= self._unheard[host] != sentence
            self._unheard[host] = sentence

    @property
    def awaits_nets(self) -> bool:
        """Whether all tasks are configured, and have reported the nets run by each."""
        return self.phase is StartupPhase.CONFIGURE and done(self.phase, self.registry.records())

    def seen(self, name: str, incarnation: int) -> None:
        """Note a possibly forged heartbeat received over DDS: end the silence of a task, nothing else."""
        with suppress(NotFoundError):
            record = self.registry.find(name)
            if record.incarnation == incarnation:
                self._silence.heard(name, record.pid, record.progress)

    def order(self, host: str) -> AgentOrder:
        """Return the order for the tasks of a host, addressed to the agent of the host."""
        return AgentOrder(int(self.phase), self.registry.incarnations(host))

    def poll(self, now: float) -> list[Started | Died]:
        """Watch the processes and go on to the next phase when all tasks are there.

        Args:
            now: Monotonic time [s].

        Returns:
            What happened to processes of this host.
        """
        for report, pid in self._agent.reports():
            self.reported(report, pid, self._host, now)
        events = self._agent.poll(now)
        for event in events:
            self._note(event)
        if self.registry.silence(now):
            self._changed = True
        for name, pid in self._silence.found(now):
            self._agent.replace(name, pid, f"nothing was heard of it for {SILENCE_S:g} s", now)
        if self.state == machine.STARTING:
            self._advance(now)
        self._agent.order(self.order(self._host))
        return events

    def changed(self) -> bool:
        """Check whether anything changed since the last call."""
        changed, self._changed = self._changed, False
        return changed

    def missing(self) -> list[str]:
        """Return a sentence for each task keeping the machine from ready; if some are broken, for broken ones only.

        Where none is to blame, what is known of the nets. Of a host without an agent, or with other files, one for the
        host.
        """
        if self._unlike:
            return list(self._unlike.values())
        records = self.registry.records()
        if not broken(records) and self.phase is StartupPhase.CONFIGURE and done(self.phase, records):
            return self._nets.failure.splitlines() or self._nets.waits(records)
        if bad := broken(records):
            return missing(StartupPhase.START, bad)
        if absent := sorted(self._unheard):
            rest = [record for record in records if record.placed.host not in self._unheard]
            agents = [f"host {host}: {self._unheard[host]}" for host in absent]
            return agents + missing(self.phase, rest)
        return missing(StartupPhase.START, records)

    def shut_down(self) -> list[str]:
        """Stop the processes of the local host; return the names of the killed ones."""
        self.state, self.phase = machine.STOPPING, StartupPhase.SHUTDOWN
        self._nets.stop()
        return self._agent.shut_down()

    def _advance(self, now: float) -> None:
        records = self.registry.records()
        if broken(records) or self._unlike:
            self.state, self._changed = machine.FAILED, True
            return
        following = next_phase(self.phase, records)
        if following is not self.phase:
            self._end_part(self.phase.name.lower(), now)
            if following is StartupPhase.START:
                if not self._may_start(records):
                    return
                self._end_part(PROOF, now)
            self.phase, self._changed = following, True
        elif self.phase is StartupPhase.START and done(StartupPhase.START, records):
            self._end_part(self.phase.name.lower(), now)
            self.state, self._changed = machine.READY, True
            self._agent.respawn = True

    def _end_part(self, part: str, now: float) -> None:
        """Record the duration of a part of the start; later calls keep the first value."""
        if part not in self.took:
            self.took[part], self._part_began, self._changed = now - self._part_began, now, True

    def _may_start(self, records: Sequence[TaskRecord]) -> bool:
        """Check whether the nets of all tasks may run together; if not, fail the start."""
        waited = self._nets.waits(records)
        settled = self._nets.settled(records)
        if self._nets.failure:
            self.state, self._changed = machine.FAILED, True
            return False
        self._changed |= settled or waited != self._nets.waits(records)
        return settled

    def _note(self, event: Started | Died) -> None:
        self._changed = True
        for task in event.tasks:
            if isinstance(event, Died):
                self.registry.died(task, event.sentence)
            else:
                self.registry.started(task, event.pid, event.restarts)
