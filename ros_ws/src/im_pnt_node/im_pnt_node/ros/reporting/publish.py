"""Firings, markings, choices, descriptions and refusals of nets as messages."""

import json
from collections.abc import Mapping, Sequence

from builtin_interfaces.msg import Time
from rclpy.publisher import Publisher
from std_msgs.msg import String

from im_core.clock import monotonic
from im_core.ros import qos
from im_core.ros.coroutines import Alarm
from im_core.ros.node import ManagedNode
from im_msgs.msg import Firing as FiringMessage
from im_msgs.msg import Marking as MarkingMessage
from im_msgs.msg import NetDescription, NetRefusal, StrategyChoice
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import ActivityState
from im_pnt.execution.notification import Firing, StrategyChosen
from im_pnt.model.net import Net
from im_pnt.netfile import yaml_text
from im_pnt.verification import Counterexample
from im_pnt_node.ros.cdr import encode_firing

MARKING_PERIOD_S = 0.02

#: How long it is told that a net has gone [s]: who knew of it is reached by then, and who did not need not be.
GONE_S = 60.0


class PntPublisher:
    """Publisher of ``/pnt/firings``, ``/pnt/markings``, ``/pnt/strategies``, ``/pnt/nets``, ``/pnt/breakpoints``.

    What was fired is published when the turn of the loop is over, so that nobody who waits for a token waits for it; of
    markings that follow each other quickly only the last one is. Each net has its own latched publisher of markings, so
    that whoever comes late gets the last one of every net.
    """

    def __init__(self, node: ManagedNode) -> None:
        self.nets: Mapping[str, Executor] = {}
        self._node = node
        self._firings = node.create_publisher(FiringMessage, "/pnt/firings", qos.EVENTS)
        self._choices = node.create_publisher(StrategyChoice, "/pnt/strategies", qos.EVENTS)
        self._refusals = node.create_publisher(NetRefusal, "/pnt/refusals", qos.LATCHED_MANY)
        self._breakpoints = node.create_publisher(String, "/pnt/breakpoints", qos.LATCHED)
        self._breakpoints_told: dict[str, list[str]] = {}
        self._markings: dict[str, Publisher] = {}
        self._descriptions: dict[str, Publisher] = {}
        self._going: dict[str, Alarm] = {}
        self._fired: list[Sequence[Firing]] = []
        self._changed: dict[str, None] = {}
        self._marked_at = 0.0
        self._entropy = (0, 0.0)
        self._mark_due = False

    def fired(self, firings: Sequence[Firing]) -> None:
        """Note firings of a net."""
        self._fired.append(firings)
        self._changed[firings[0].net] = None

    def changed(self, net: str) -> None:
        """Note a change in the operation of a net."""
        self._changed[net] = None

    def publish(self) -> None:
        """Publish the noted events; firings of one turn have one stamp."""
        fired, self._fired = self._fired, []
        if fired and self._firings.get_subscription_count() > 0:
            now, publish = self._now(), self._firings.publish
            for firings in fired:
                for firing in firings:
                    publish(encode_firing(firing, now.sec, now.nanosec))
        if self._changed and not self._mark_due:
            left = self._marked_at + MARKING_PERIOD_S - monotonic()
            if left <= 0.0:
                self._mark()
            else:
                self._mark_due = True
                self._node.alarms.after(left, self._mark)

    def _mark(self) -> None:
        self._mark_due = False
        self._marked_at = monotonic()
        changed, self._changed = self._changed, {}
        for net in changed:
            if net in self.nets:  # it may have gone since
                self.marked(self.nets[net])

    def marked(self, executor: Executor) -> None:
        """Publish the marking of a net, and the mode of operation."""
        marking, name = executor.marking(), executor.net.name
        activities = list(executor.activities)

        def of(*states: ActivityState) -> list[str]:
            return sorted({activity.transition for activity in activities if activity.state in states})

        self._tell_breakpoints(name, executor.breakpoints)
        if name not in self._markings:
            self._markings[name] = self._node.create_publisher(MarkingMessage, "/pnt/markings", qos.LATCHED)
        self._markings[name].publish(
            MarkingMessage(
                stamp=self._now(),
                net=name,
                sequence=executor.sequence,
                places=list(marking),
                tokens=list(marking.values()),
                active=of(*ActivityState),
                cancelling=of(ActivityState.CANCELLING),
                in_doubt=of(ActivityState.IN_DOUBT),
                mode=executor.operator.mode,
                paused=executor.paused,
                proposed=list(executor.proposed),
            )
        )

    def _tell_breakpoints(self, net: str, breakpoints: Sequence[str]) -> None:
        """Publish the breakpoints of all nets of the node, if those of a net have changed: JSON, transitions by net."""
        if list(breakpoints) == self._breakpoints_told.get(net, []):
            return
        self._breakpoints_told[net] = list(breakpoints)
        told = {name: each for name, each in self._breakpoints_told.items() if each}
        content = {"node": self._node.get_fully_qualified_name(), "breakpoints": told}
        self._breakpoints.publish(String(data=json.dumps(content)))

    def chose(self, choice: StrategyChosen) -> None:
        """Publish a choice among strategies."""
        command = choice.job.command.id if choice.job is not None else 0
        if command != self._entropy[0]:
            self._entropy = (command, 0.0)
        self._entropy = (command, self._entropy[1] + choice.entropy)
        self._choices.publish(
            StrategyChoice(
                stamp=self._now(),
                net=choice.net,
                alternatives=list(choice.probabilities),
                probabilities=list(choice.probabilities.values()),
                entropy=choice.entropy,
                taken=choice.taken,
                context=choice.context,
                command=command,
                command_entropy=self._entropy[1],
            )
        )

    def described(self, executor: Executor) -> None:
        """Publish a net: the clients, and the text of the file."""
        net = executor.written
        if (going := self._going.pop(net.name, None)) is not None:
            self._node.alarms.cancel(going)
        content = {**_heading(net), "yaml": yaml_text(net), "journal": executor.record is not None}
        if net.name not in self._descriptions:
            self._descriptions[net.name] = self._node.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED)
        self._descriptions[net.name].publish(
            NetDescription(net=net.name, node=self._node.get_fully_qualified_name(), json=json.dumps(content))
        )

    def withdrawn(self, net: str) -> None:
        """Publish the removal of a net, as a description without content, kept for late subscribers for a minute."""
        self._descriptions[net].publish(NetDescription(net=net, node=self._node.get_fully_qualified_name()))
        self._tell_breakpoints(net, ())
        self._going[net] = self._node.alarms.after(GONE_S, lambda: self._forget(net))

    def _forget(self, net: str) -> None:
        del self._going[net]
        for publishers in (self._descriptions, self._markings):
            if (publisher := publishers.pop(net, None)) is not None:
                self._node.destroy_publisher(publisher)

    def refused(self, net: str, message: str, nets: Sequence[Net], refusals: Sequence[Counterexample]) -> None:
        """Publish the refusal of a net, with a firing sequence as the counterexample, if there is one.

        Args:
            net: Name of the net.
            message: Why.
            nets: The nets that were verified together.
            refusals: What the verification found; the first one is told.
        """
        content: dict[str, object] = {}
        for refusal in refusals[:1]:
            content = {
                "reason": refusal.reason,
                "nets": [yaml_text(each) for each in nets],
                "sequence": list(refusal.sequence),
                "repeat": list(refusal.repeat),
            }
        self._refusals.publish(
            NetRefusal(
                stamp=self._now(),
                net=net,
                node=self._node.get_fully_qualified_name(),
                message=message,
                json=json.dumps(content),
            )
        )

    def _now(self) -> Time:
        return self._node.get_clock().now().to_msg()


def _heading(net: Net) -> dict[str, object]:
    return {
        "net": net.name,
        "description": net.description,
        "symbols": net.symbols(),
        "services": sorted(net.services),
        "places": sorted(net.places),
    }
