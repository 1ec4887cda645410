"""Process of :class:`im_mcs.testbed.joint_state.JointStateDriver`: ``python -m im_mcs.ros.topic_channels SETTINGS``.

The driver starts it and ends it; SETTINGS is JSON. It ends by itself when the driver is gone.
"""

import json
import sys
import threading
from typing import Any

from sensor_msgs.msg import JointState

from im_core import clock
from im_core.errors import LinkError
from im_core.processes.startup import patience_s
from im_core.ros import qos
from im_core.ros import run as ros_run
from im_core.ros.guard import GuardedNode
from im_mcs.testbed.joint_state import TopicLink

_BELL_S = 0.1


class TopicChannels(GuardedNode):
    """Joint states into shared memory, efforts out of shared memory.

    Args:
        name: Of the shared memory.
        joints: In the order of the channels.
        state: Topic of the robot's positions.
        command: Topic of the efforts.
        silence_s: Efforts that were given longer ago are not published [s].
    """

    def __init__(self, name: str, joints: list[str], state: str, command: str, silence_s: float) -> None:
        super().__init__("topic_channels", namespace="/mcs")
        self._link = TopicLink.attach(name, TopicLink.layout(len(joints)), patience_s())
        self._joints, self._silence_s = joints, silence_s
        self._channel = {joint: channel for channel, joint in enumerate(joints)}
        self._received = self._link.received.record()
        self._publisher = self.create_publisher(JointState, command, qos.SENSOR)
        self.create_subscription(JointState, state, self._take, qos.SENSOR)
        self._running = True
        self._thread = threading.Thread(target=self._give, name="efforts", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the driver lives."""
        return self._running

    def stop(self) -> None:
        """End the thread and let go of the memory."""
        self._running = False
        self._thread.join()
        self._link.close()

    def _take(self, message: JointState) -> None:
        received, now = self._received, clock.monotonic()
        for joint, position in zip(message.name, message.position, strict=False):
            channel = self._channel.get(joint)
            if channel is not None:
                received["q"][channel] = position
                received["at"][channel] = now
        received["named"] = ", ".join(message.name).encode()[:1024]
        self._link.received.write(received)

    def _give(self) -> None:
        while self._running:
            if not self._link.bell.wait(_BELL_S):
                if not self._link.owner_alive():
                    self._running = False
                    if self.executor is not None:
                        self.executor.shutdown()
                continue
            self._link.bell.drain()
            try:
                command = self._link.command.read()
            except LinkError:
                continue  # the driver stands still in the middle of a command; the next one may be whole
            driven, age_s = command["driven"], clock.monotonic() - float(command["at"])
            if driven.any() and age_s <= self._silence_s:
                message = JointState()
                message.header.stamp = self.get_clock().now().to_msg()
                message.name = [joint for joint, on in zip(self._joints, driven, strict=True) if on]
                message.effort = command["effort"][driven].tolist()
                self._publisher.publish(message)


def main(arguments: list[str]) -> int:
    """Run until SIGTERM, or until the driver is gone."""
    settings: dict[str, Any] = json.loads(arguments[0])
    return ros_run.main(lambda: TopicChannels(**settings), [], TopicChannels.stop)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
