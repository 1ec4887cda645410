"""Work that waits in the loop of a node: ten thousand messages, behind which a stop is sent."""

import threading

from rclpy.qos import QoSProfile
from std_msgs.msg import Int32

from im_core import clock

MANY = 10_000
PATIENCE_S = 300.0
TOPICS = [f"/flood/work_{number}" for number in range(4)]
QUEUE = QoSProfile(depth=MANY // len(TOPICS))  # of one reader Fast DDS keeps 5,000


class Flood:
    """Messages of a sender to a node, whose loop is held at the first of them until all are there.

    Attributes:
        taken: How many messages the node has taken.
        before: How many of them before the stop; None: it was not seen yet.
    """

    def __init__(self, node, sender):
        self.taken, self.before = 0, None
        self._held, self._go = threading.Event(), threading.Event()
        self._readers = [node.create_subscription(Int32, topic, self._work, QUEUE) for topic in TOPICS]
        self._writers = [sender.create_publisher(Int32, topic, QUEUE) for topic in TOPICS]
        self._node, self._sender = node, sender

    def _work(self, _):
        self.taken += 1
        if not self._go.is_set():
            self._held.set()
            assert self._go.wait(PATIENCE_S)
        elif self.before is None and self.taken < MANY / 2:
            clock.sleep(0.001)  # of a slow computer the stop, or what tells of it, is still on its way

    def fill(self, wait_until):
        """Send all of them, and return when the node is held at the first."""
        wait_until(lambda: all(each.get_subscription_count() for each in self._writers), "the readers", PATIENCE_S)
        for _ in range(MANY // len(TOPICS)):
            for writer in self._writers:
                writer.publish(Int32())
        assert self._held.wait(PATIENCE_S)

    def stopped(self, *_):
        """Note that the stop was carried out; a callback of its answer."""
        if self.before is None:
            self.before = self.taken

    def let_go(self, wait_until, stopped=lambda: False):
        """Let the node go on; all messages are taken in the end, most of them after the stop.

        Args:
            wait_until: Waits for a condition.
            stopped: Whether the stop was carried out, where no callback tells.
        """
        self._go.set()

        def seen():
            if stopped():
                self.stopped()
            return self.before is not None

        wait_until(seen, "the stop", PATIENCE_S)
        wait_until(lambda: self.taken == MANY, f"all {MANY} messages", PATIENCE_S)
        assert self.before < MANY / 2

    def end(self):
        """Let the node go, and take the messages from it."""
        self._go.set()
        for reader in self._readers:
            self._node.destroy_subscription(reader)
        for writer in self._writers:
            self._sender.destroy_publisher(writer)
