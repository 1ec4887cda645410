"""Firings, markings and net descriptions as messages."""

import json

from rclpy.node import Node
from rclpy.publisher import Publisher

from im_core.ros import qos
from im_msgs.msg import Firing as FiringMessage
from im_msgs.msg import Marking as MarkingMessage
from im_msgs.msg import NetDescription
from im_pnt.draw import draw
from im_pnt.events import Firing
from im_pnt.executive import Executive


class PntPublisher:
    """Publishes what nets do on ``/pnt/firings``, ``/pnt/markings`` and ``/pnt/nets``.

    Each net has its own latched publisher of markings, so that whoever comes late gets the last one of every net.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._firings = node.create_publisher(FiringMessage, "/pnt/firings", qos.EVENTS)
        self._markings: dict[str, Publisher] = {}
        self._descriptions: dict[str, Publisher] = {}

    def firing(self, firing: Firing) -> None:
        """Publishes a firing, stamped with the node's clock."""
        self._firings.publish(
            FiringMessage(
                stamp=self._node.get_clock().now().to_msg(),
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

    def marking(self, executive: Executive) -> None:
        """Publishes the marking of a net."""
        marking = executive.marking()
        name = executive.net.name
        if name not in self._markings:
            self._markings[name] = self._node.create_publisher(MarkingMessage, "/pnt/markings", qos.LATCHED)
        self._markings[name].publish(
            MarkingMessage(
                stamp=self._node.get_clock().now().to_msg(),
                net=name,
                sequence=executive.sequence,
                places=list(marking),
                tokens=list(marking.values()),
                active=sorted({activity.transition for activity in executive.activities}),
            )
        )

    def description(self, executive: Executive) -> None:
        """Publishes the structure and drawing of a net."""
        net = executive.written
        content = {
            "description": net.description,
            "symbols": net.symbols(),
            "services": sorted(net.services),
            "drawing": draw(net).to_dict(),
        }
        if net.name not in self._descriptions:
            self._descriptions[net.name] = self._node.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED)
        self._descriptions[net.name].publish(
            NetDescription(net=net.name, node=self._node.get_fully_qualified_name(), json=json.dumps(content))
        )
