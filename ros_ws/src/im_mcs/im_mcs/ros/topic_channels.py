"""Process of the drivers in :mod:`im_mcs.testbed.joint_state`: ``python -m im_mcs.ros.topic_channels SETTINGS``.

The driver starts it and ends it; SETTINGS is JSON. It ends by itself when the driver is gone.
"""

import json
import sys
import threading
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from numpy.typing import NDArray
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from im_core import clock
from im_core.errors import LinkError
from im_core.processes.startup import patience_s
from im_core.ros import qos
from im_core.ros import run as ros_run
from im_core.ros.guard import GuardedNode
from im_core.ros.messages.interfaces import message_class
from im_mcs.limits.slots import Interface
from im_mcs.testbed.joint_state import FaultTopic, TopicLink
from im_mcs.testbed.stamp_clock import StampClock

_BELL_S = 0.1
# for how long joints that are driven no more are told to stand
_STAND_S = 0.5
_LAST_TIMES, _LAST_PAUSE_S = 5, 0.02


class TopicChannels(GuardedNode):
    """Joint states into shared memory, commands out of shared memory.

    Args:
        name: Of the shared memory.
        joints: In the order of the channels.
        kinds: What the commands of each are.
        state: Topic of the robot's positions.
        command: Topic of the commands.
        silence_s: Commands that were given longer ago are not published [s].
        faults: Fields of the :class:`FaultTopic`.
        order: Joints in the order of the numbers of a command; None: commands are joint states, with names.
    """

    points = 0

    def __init__(
        self,
        name: str,
        joints: Sequence[str],
        kinds: Sequence[Interface],
        state: str,
        command: str,
        silence_s: float,
        faults: Sequence[dict[str, Any]] = (),
        order: Sequence[str] | None = None,
    ) -> None:
        super().__init__("topic_channels", namespace="/mcs")
        self._link = TopicLink.attach(name, TopicLink.layout(len(joints), self.points), patience_s())
        self._joints, self._silence_s = list(joints), silence_s
        self._channel = {joint: channel for channel, joint in enumerate(joints)}
        self._clocks: dict[int, StampClock] = defaultdict(StampClock)
        self._kinds = {kind: np.array([own == kind for own in kinds]) for kind in dict.fromkeys(kinds)}
        self._order = None if order is None else [self._channel[joint] for joint in order]
        self._received = self._link.received.record()
        self._received["speed"] = 1.0
        self._lock = threading.Lock()
        self._faults: dict[str, str] = {}
        self._silent: dict[str, Timer] = {}
        self._place = self._stand = np.full(len(joints), np.nan)
        self._driven = self._standing = np.zeros(len(joints), dtype=np.bool_)
        self._stand_until = 0.0
        try:
            for given in faults:
                self._watch(FaultTopic.model_validate(given))
            self._open(command)
        except Exception as error:
            self._received["broken"] = str(error).encode()[:512]
            self._link.received.write(self._received)
            raise
        self.create_subscription(JointState, state, self._take, qos.SENSOR)
        self._running = True
        self._thread = threading.Thread(target=self._give, name="commands", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the driver lives."""
        return self._running

    def stop(self) -> None:
        """End the thread, which lets joints stand, and let go of the memory."""
        self._running = False
        self._thread.join()
        self._link.close()

    def _take(self, message: JointState) -> None:
        now, stamp = clock.monotonic(), message.header.stamp
        told = [(self._channel.get(joint), q) for joint, q in zip(message.name, message.position, strict=False)]
        places = [(channel, q) for channel, q in told if channel is not None]
        with self._lock:
            received = self._received
            if places:  # publishers of different joints have clocks of their own
                channels, q = zip(*places, strict=True)
                taken_s = self._clocks[channels[0]].taken_s(stamp.sec + 1e-9 * stamp.nanosec, now)
                received["q"][list(channels)], received["at"][list(channels)] = q, taken_s
            received["named"] = ", ".join(message.name).encode()[:1024]
            self._link.received.write(received)

    # faults

    def _watch(self, fault: FaultTopic) -> None:
        """Listen to a fault topic, also to the last message of a publisher that was there before."""
        key = f"{fault.topic} {fault.status or fault.field}"
        take = partial(self._take_fault if fault.status is None else self._take_diagnostics, fault, key)
        message_type = DiagnosticArray
        if fault.status is None:
            message_type = self._class_of(fault.topic, fault.type, fault.field)
        self._note_fault(key, f"nothing was heard of {key}")
        if fault.silence_s is not None:
            self._silent[key] = self.create_timer(fault.silence_s, partial(self._note_silence, key, fault.silence_s))
        self._listen(message_type, fault.topic, take)

    @staticmethod
    def _class_of(topic: str, name: str, field: str) -> Any:
        """Return the class of a topic's messages, which must have a field."""
        found = message_class(name)
        if not hasattr(found(), field):
            raise LinkError(f"topic '{topic}': {name} has no field '{field}'")
        return found

    def _listen(self, message_type: Any, topic: str, take: Callable[[Any], None]) -> None:
        for profile in (qos.SENSOR, qos.LATCHED):
            self.create_subscription(message_type, topic, take, profile)

    def _take_fault(self, fault: FaultTopic, key: str, message: Any) -> None:
        value = getattr(message, fault.field)
        self._note_fault(key, "" if value in fault.good else f"{key} is {value}")

    def _take_diagnostics(self, fault: FaultTopic, key: str, message: DiagnosticArray) -> None:
        ours = [status for status in message.status if status.name.startswith(fault.status or "")]
        if ours:
            bad = [status for status in ours if status.level >= DiagnosticStatus.ERROR]
            self._note_fault(key, "; ".join(f"{fault.topic} {status.name}: {status.message}" for status in bad))

    def _note_silence(self, key: str, silence_s: float) -> None:
        if not self._faults[key]:
            self._note_fault(key, f"nothing was heard of {key} for {silence_s:g} s")

    def _note_fault(self, key: str, told: str) -> None:
        if key in self._silent:
            self._silent[key].reset()
        if self._faults.get(key) == told:
            return
        self._faults[key] = told
        with self._lock:
            self._received["faults"] = "; ".join(filter(None, self._faults.values())).encode()[:512]
            self._link.received.write(self._received)

    # commands

    def _open(self, command: str) -> None:
        """Make the publisher of commands."""
        self._publisher = self.create_publisher(
            JointState if self._order is None else Float64MultiArray, command, qos.NEWEST
        )

    def _give(self) -> None:
        unknown, none = np.full(len(self._joints), np.nan), np.zeros(len(self._joints), dtype=np.bool_)
        while self._running:
            if self._link.bell.wait(_BELL_S):
                self._link.bell.drain()
            elif not self._link.owner_alive():
                break
            value, driven = unknown, none
            self._stamp = self.get_clock().now().to_msg()  # of a process held up from here on the command is old
            try:
                command = self._link.command.read()
            except LinkError:
                pass  # the driver stands still in the middle of a command; the next one may be whole
            else:
                if clock.monotonic() - float(command["at"]) <= self._silence_s:
                    value, driven = command["value"].copy(), command["driven"].copy()
            self._publish(value, driven)
        for _ in range(_LAST_TIMES):
            self._stamp = self.get_clock().now().to_msg()
            self._publish(unknown, none)
            clock.sleep(_LAST_PAUSE_S)
        if self._running:
            self._running = False
            if self.executor is not None:
                self.executor.shutdown()

    def _publish(self, value: NDArray[np.float64], driven: NDArray[np.bool_]) -> None:
        """Publish the commands of driven joints; of joints that are driven no more, for a moment, that they stand.

        Args:
            value: Commands, and where joints that are not driven stand, shape (n,); NaN: where they were last measured.
            driven: Which joints are driven, shape (n,).
        """
        now, left = clock.monotonic(), self._driven & ~driven
        with self._lock:
            q = self._received["q"].copy()
            q[self._received["at"] == 0.0] = np.nan
        self._place = np.where(np.isfinite(q), q, self._place)
        given = np.where(np.isfinite(value), value, self._place)
        self._stand = np.where(np.isfinite(self._stand), self._stand, given)
        if left.any():
            self._stand[left], self._stand_until = given[left], now + _STAND_S
        self._driven = driven
        standing = (self._standing | left) & ~driven & (now < self._stand_until)
        self._standing = standing
        if not (driven | standing).any():
            self._stand = given
            return
        value = np.where(driven, value, 0.0)
        if (positions := self._kinds.get("position")) is not None:
            value = np.where(positions & ~driven, self._stand, value)
        if self._order is not None:
            if np.isfinite(value).all():
                self._publisher.publish(Float64MultiArray(data=value[self._order].tolist()))
            return
        for kind, mask in self._kinds.items():
            told = mask & np.isfinite(value) & (driven if kind == "effort" else driven | standing)
            if told.any():
                message = JointState(name=[joint for joint, on in zip(self._joints, told, strict=True) if on])
                message.header.stamp = self._stamp
                setattr(message, kind, value[told].tolist())
                self._publisher.publish(message)


def main(arguments: list[str]) -> int:
    """Run until SIGTERM, or until the driver is gone."""
    settings: dict[str, Any] = json.loads(arguments[0])
    return ros_run.main(lambda: TopicChannels(**settings), [], TopicChannels.stop)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
