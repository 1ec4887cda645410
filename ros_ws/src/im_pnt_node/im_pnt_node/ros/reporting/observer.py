"""Distributor of the reports of nets: to topics, clients of commands, and the log."""

from collections.abc import Sequence

from im_core.ros.node import ManagedNode
from im_core.ros.repeated_warnings import LINK, Reminders
from im_pnt.execution.jobs import Job
from im_pnt.execution.notification import Firing, Observer, StrategyChosen
from im_pnt.execution.operator import Mode
from im_pnt_node.ros.commands.commands import Commands
from im_pnt_node.ros.reporting.publish import PntPublisher


class NodeObserver(Observer):
    """The observer of the nets of a node.

    Attributes:
        publisher: As given.
        commands: Tells clients; None: there are none yet.
    """

    def __init__(self, node: ManagedNode, publisher: PntPublisher) -> None:
        self._node, self.publisher = node, publisher
        self.commands: Commands | None = None
        self._reminders = Reminders(node)
        self._lost_objects: set[str] = set()

    def fired(self, firings: Sequence[Firing]) -> None:
        """Note firings, and inform the clients of the commands."""
        self.publisher.fired(firings)
        if self.commands is not None:
            self.commands.fired(firings)

    def progressed(self, net: str, job: Job | None, text: str, fraction: float) -> None:
        """Inform the clients of a command of the progress."""
        if job is not None and self.commands is not None:
            self.commands.progressed(job.command.id, text, fraction)

    def troubled(self, net: str, text: str) -> None:
        """Write a line to the log."""
        self._node.get_logger().warning(f"net {net}: {text}" if net else text)

    def forgot(self, text: str) -> None:
        """Write a loss to the log, keep the loss on ``/diagnostics``, and note the loss with the open commands."""
        self._reminders.add("journal", text)
        if self.commands is not None:
            self.commands.note_event(text)

    def restarted(self, task: str) -> None:
        """Note with the commands under way the restart of a task."""
        if self.commands is not None:
            self.commands.note_event(f"{task} was started again")

    def lost_object(self, text: str) -> None:
        """Say once, in the log, on ``/diagnostics`` and with the commands under way: a data object is damaged."""
        if text not in self._lost_objects:
            self._lost_objects.add(text)
            self._reminders.add("objects", text)
        if self.commands is not None:
            self.commands.note_event(text)

    def unreached(self, node: str, text: str) -> None:
        """Write a line of the log, and name on ``/diagnostics`` a node out of reach of messages."""
        subject = f"{LINK}{node}"
        if text:
            self._reminders.add(subject, text)
        else:
            self._reminders.end(subject)

    def unproved(self, text: str) -> None:
        """Write to the log and to ``/diagnostics``: a net runs without proof."""
        self._reminders.add("nets", text)

    def chose(self, choice: StrategyChosen) -> None:
        """Publish a choice among strategies."""
        self.publisher.chose(choice)

    def operated(
        self, net: str, mode: Mode, paused: bool, proposed: tuple[str, ...], breakpoints: tuple[str, ...]
    ) -> None:
        """Has the marking shown anew."""
        self.publisher.changed(net)
