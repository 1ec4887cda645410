"""Bootstrap (paper, section 3): takes all tasks of a deployment through the start-up phases, and watches them after."""

from collections.abc import Sequence

from im_bringup import machine, phases
from im_bringup.agent import Agent, Died, Started
from im_bringup.deployment import Placed
from im_bringup.phases import Phase
from im_bringup.registry import Progress, Registry


class Bootstrap:
    """Decides in which phase the machine is.

    A task that fails or dies before the machine was ready makes the start fail. One that dies later is started
    again and passes through the phases alone.

    Args:
        tasks: All tasks of the deployment.
        agent: Agent of this host.
        host: Name of this host in the deployment.
    """

    def __init__(self, tasks: Sequence[Placed], agent: Agent, host: str) -> None:
        self.registry = Registry(tasks, host)
        self.phase = Phase.LOAD
        self.state = machine.STARTING
        self._agent = agent
        self._changed = True

    def start(self) -> None:
        """Start the processes of this host."""
        for event in self._agent.start():
            self._note(event)

    def heard(self, name: str, pid: int, incarnation: int, progress: Progress, detail: str, now: float) -> None:
        """Take a heartbeat; arguments as in :meth:`im_bringup.registry.Registry.heard`."""
        if self.registry.heard(name, pid, incarnation, progress, detail, now):
            self._changed = True

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
        return phases.missing(Phase.START, phases.broken(records) or records)

    def shut_down(self) -> list[str]:
        """Stop the processes of this host; returns the names of the tasks that had to be killed."""
        self.state, self.phase = machine.STOPPING, Phase.SHUTDOWN
        return self._agent.shut_down()

    def _advance(self) -> None:
        records = self.registry.records()
        if phases.broken(records):
            self.state, self._changed = machine.FAILED, True
            return
        following = phases.next_phase(self.phase, records)
        if following is not self.phase:
            self.phase, self._changed = following, True
        elif self.phase is Phase.START and phases.done(Phase.START, records):
            self.state, self._changed = machine.READY, True
            self._agent.respawn = True

    def _note(self, event: Started | Died) -> None:
        self._changed = True
        if isinstance(event, Died):
            self.registry.died(event.name, event.sentence)
        else:
            self.registry.started(event.name, event.pid, event.restarts)
