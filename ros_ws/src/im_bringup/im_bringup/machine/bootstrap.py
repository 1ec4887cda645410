"""Bootstrap (paper, section 3): takes all tasks of a deployment through the start-up phases, and watches them after.

No task enters a phase before all tasks have finished the one before.
"""

from collections.abc import Iterable, Sequence

from im_bringup.machine import record as machine
from im_bringup.tasks.agent import Agent, Died, Started
from im_bringup.tasks.deployment import PlacedTask
from im_bringup.tasks.registry import Progress, Registry, TaskRecord
from im_core.startup import StartupPhase

#: A task of this host that was ready and is silent for longer is started again [s].
SILENCE_S = 30.0
#: A pause between two looks counts as silence for no more than this [s].
_LONGEST_PAUSE_S = 0.5

#: How far a task must be for its part of a phase to be done.
_DONE = {
    StartupPhase.LOAD: Progress.LOADED,
    StartupPhase.CONFIGURE: Progress.CONFIGURED,
    StartupPhase.START: Progress.READY,
}
_WORDS = {StartupPhase.LOAD: "loaded", StartupPhase.CONFIGURE: "configured", StartupPhase.START: "ready"}


def done(phase: StartupPhase, records: Iterable[TaskRecord]) -> bool:
    """Whether all tasks have finished a phase."""
    return all(_finished(phase, record) for record in records)


def next_phase(phase: StartupPhase, records: Sequence[TaskRecord]) -> StartupPhase:
    """The phase the machine may be in: the following one if all tasks have finished this one."""
    if phase < StartupPhase.START and done(phase, records):
        return StartupPhase(phase + 1)
    return phase


def missing(phase: StartupPhase, records: Iterable[TaskRecord]) -> list[str]:
    """One sentence for each task that has not finished a phase: who, where it is, and why if it told."""
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
    """The tasks that will not go on by themselves: failed or dead."""
    return [record for record in records if record.progress in (Progress.FAILED, Progress.DEAD)]


def _finished(phase: StartupPhase, record: TaskRecord) -> bool:
    if phase is StartupPhase.SHUTDOWN:
        return record.progress is Progress.DEAD
    return _DONE[phase] <= record.progress <= Progress.READY


class SilentTasks:
    """Which tasks have fallen silent, though they may run: their messages no longer come through.

    Silence is counted only while this process listens itself: a pause between two looks counts for the little that it
    should have been, so that whoever was stopped or had no processor blames nobody.
    """

    def __init__(self) -> None:
        self._silent_s: dict[tuple[str, int], float] = {}
        self._looked: float | None = None

    def heard(self, name: str, pid: int, progress: Progress) -> None:
        """A heartbeat of a task came; once it is ready it may fall silent. What it does before may take long."""
        for other in [known for known in self._silent_s if known[0] == name]:
            del self._silent_s[other]
        if progress is Progress.READY:
            self._silent_s[name, pid] = 0.0

    def found(self, now: float) -> list[tuple[str, int]]:
        """Task and process of those that have become silent since the last look; each is told once.

        Args:
            now: Monotonic time [s].
        """
        passed = 0.0 if self._looked is None else min(now - self._looked, _LONGEST_PAUSE_S)
        self._looked = now
        for task in self._silent_s:
            self._silent_s[task] += passed
        silent = [task for task, seconds in self._silent_s.items() if seconds > SILENCE_S]
        for task in silent:
            del self._silent_s[task]
        return silent


class Bootstrap:
    """Decides in which phase the machine is.

    A task that fails or dies before the machine was ready makes the start fail. One that does so later is started
    again and passes through the phases alone.

    Args:
        tasks: All tasks of the deployment.
        agent: Agent of this host.
        host: Name of this host in the deployment.
    """

    def __init__(self, tasks: Sequence[PlacedTask], agent: Agent, host: str) -> None:
        self.registry = Registry(tasks, host)
        self.phase = StartupPhase.LOAD
        self.state = machine.STARTING
        self._agent = agent
        self._silence = SilentTasks()
        self._changed = True

    def start(self) -> None:
        """Start the processes of this host."""
        for event in self._agent.start():
            self._note(event)

    def heard(self, name: str, pid: int, incarnation: int, progress: Progress, detail: str, now: float) -> None:
        """Take a heartbeat; arguments as in :meth:`im_bringup.tasks.registry.Registry.heard`."""
        self._silence.heard(name, pid, progress)
        if self.registry.heard(name, pid, incarnation, progress, detail, now):
            self._changed = True
            if progress is Progress.FAILED:
                self._agent.replace(name, pid, detail, now)

    def poll(self, now: float) -> list[Started | Died]:
        """Watch the processes and go on to the next phase when all tasks are there.

        Args:
            now: Monotonic time [s].

        Returns:
            What happened to processes of this host.
        """
        events = self._agent.poll(now)
        for event in events:
            self._note(event)
        if self.registry.silence(now):
            self._changed = True
        for name, pid in self._silence.found(now):
            self._agent.replace(name, pid, f"nothing was heard of it for {SILENCE_S:g} s", now)
        if self.state == machine.STARTING:
            self._advance()
        return events

    def changed(self) -> bool:
        """Whether anything changed since this was asked last."""
        changed, self._changed = self._changed, False
        return changed

    def missing(self) -> list[str]:
        """One sentence for each task that keeps the machine from being ready; if some are broken, only these."""
        records = self.registry.records()
        return missing(StartupPhase.START, broken(records) or records)

    def shut_down(self) -> list[str]:
        """Stop the processes of this host; returns the names of the tasks that had to be killed."""
        self.state, self.phase = machine.STOPPING, StartupPhase.SHUTDOWN
        return self._agent.shut_down()

    def _advance(self) -> None:
        records = self.registry.records()
        if broken(records):
            self.state, self._changed = machine.FAILED, True
            return
        following = next_phase(self.phase, records)
        if following is not self.phase:
            self.phase, self._changed = following, True
        elif self.phase is StartupPhase.START and done(StartupPhase.START, records):
            self.state, self._changed = machine.READY, True
            self._agent.respawn = True

    def _note(self, event: Started | Died) -> None:
        self._changed = True
        if isinstance(event, Died):
            self.registry.died(event.name, event.sentence)
        else:
            self.registry.started(event.name, event.pid, event.restarts)
