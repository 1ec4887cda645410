"""Firings, markings, choices, descriptions and refusals of nets as messages."""

import json
from collections.abc import Mapping, Sequence

from builtin_interfaces.msg import Time
from rclpy.publisher import Publisher

from im_core.clock import monotonic
from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_msgs.msg import Firing as FiringMessage
from im_msgs.msg import Marking as MarkingMessage
from im_msgs.msg import NetDescription, NetRefusal, StrategyChoice
from im_pnt.analysis.report import Report
from im_pnt.display.story import description, story
from im_pnt.events import Firing
from im_pnt.executive import Executive
from im_pnt.jobs import ActivityState
from im_pnt.net import Net
from im_pnt.netfile.writer import yaml_text
from im_pnt.replay import Script

MARKING_PERIOD_S = 0.02


class PntPublisher:
    """Publishes what nets do on ``/pnt/firings``, ``/pnt/markings``, ``/pnt/strategies``, ``/pnt/nets``.

    What was fired is published when the turn of the loop is over, so that nobody who waits for a token waits for it; of
    markings that follow each other quickly only the last one is. Each net has its own latched publisher of markings, so
    that whoever comes late gets the last one of every net.

    Attributes:
        nets: The nets of the node, by name.
    """

    def __init__(self, node: ManagedNode) -> None:
        self.nets: Mapping[str, Executive] = {}
        self._node = node
        self._firings = node.create_publisher(FiringMessage, "/pnt/firings", qos.EVENTS)
        self._choices = node.create_publisher(StrategyChoice, "/pnt/strategies", qos.EVENTS)
        self._refusals = node.create_publisher(NetRefusal, "/pnt/refusals", qos.LATCHED_MANY)
        self._markings: dict[str, Publisher] = {}
        self._descriptions: dict[str, Publisher] = {}
        self._fired: list[Firing] = []
        self._changed: dict[str, None] = {}
        self._marked_at = 0.0
        self._mark_due = False

    def fired(self, firing: Firing) -> None:
        """Notes a firing."""
        self._fired.append(firing)
        self._changed[firing.net] = None

    def changed(self, net: str) -> None:
        """Notes that how a net is operated has changed."""
        self._changed[net] = None

    def publish(self) -> None:
        """Publishes what was noted; firings of one turn have one stamp."""
        fired, self._fired = self._fired, []
        heard = bool(fired) and self._firings.get_subscription_count() > 0
        now = self._now() if heard else None
        for firing in fired if heard else ():
            self._firings.publish(
                FiringMessage(
                    stamp=now,
                    net=firing.net,
                    transition=firing.transition,
                    sequence=firing.sequence,
                    phase=int(firing.phase),
                    symbol=firing.symbol,
                    command_id=firing.command_id,
                    message=firing.message,
                    duration=firing.duration,
                    progress=firing.progress,
                )
            )
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
            self.marked(self.nets[net])

    def marked(self, executive: Executive) -> None:
        """Publishes the marking of a net, and how it is operated."""
        marking, name = executive.marking(), executive.net.name
        activities = list(executive.activities)

        def of(*states: ActivityState) -> list[str]:
            return sorted({activity.transition for activity in activities if activity.state in states})

        if name not in self._markings:
            self._markings[name] = self._node.create_publisher(MarkingMessage, "/pnt/markings", qos.LATCHED)
        self._markings[name].publish(
            MarkingMessage(
                stamp=self._now(),
                net=name,
                sequence=executive.sequence,
                places=list(marking),
                tokens=list(marking.values()),
                active=of(*ActivityState),
                cancelling=of(ActivityState.CANCELLING),
                in_doubt=of(ActivityState.IN_DOUBT),
                mode=executive.mode,
                paused=executive.paused,
                proposed=list(executive.proposed),
            )
        )

    def chose(self, net: str, probabilities: Mapping[str, float], entropy: float, taken: str) -> None:
        """Publishes a choice among strategies."""
        self._choices.publish(
            StrategyChoice(
                stamp=self._now(),
                net=net,
                alternatives=list(probabilities),
                probabilities=list(probabilities.values()),
                entropy=entropy,
                taken=taken,
            )
        )

    def described(self, executive: Executive) -> None:
        """Publishes the structure and drawing of a net."""
        net = executive.written
        content = {**description(net), "yaml": yaml_text(net), "journal": executive.record is not None}
        if net.name not in self._descriptions:
            self._descriptions[net.name] = self._node.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED)
        self._descriptions[net.name].publish(
            NetDescription(net=net.name, node=self._node.get_fully_qualified_name(), json=json.dumps(content))
        )

    def refused(self, net: str, message: str, nets: Sequence[Net], report: Report) -> None:
        """Publishes why a net was refused, with the firing sequence that shows it, if there is one.

        Args:
            net: Name of the net.
            message: Why.
            nets: The nets that were verified together.
            report: Of the verification.
        """
        content: dict[str, object] = {}
        for refusal in report.refusals[:1]:
            try:
                content = story(nets, Script(refusal.sequence, refusal.repeat, refusal.reason))
            except ImError as error:
                self._node.get_logger().warning(f"the counterexample cannot be shown: {error.message}")
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
