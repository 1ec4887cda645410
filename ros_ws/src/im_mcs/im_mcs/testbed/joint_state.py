"""Channel driver of a robot on topics: ``sensor_msgs/JointState`` one way and the other."""

import json
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_core import clock
from im_core.errors import ConfigError, LinkError
from im_core.processes.process import ChildProcess
from im_core.shm import Semaphore, SharedBlock, SharedRecord, Snapshot
from im_mcs.testbed.driver import Drive, Measured

_BRIDGE = "im_mcs.ros.topic_channels"
_POLL_S, _AGAIN_S = 0.01, 1.0


class TopicLink(SharedRecord):
    """Memory between driver and bridge: received readings one way, commands for publication the other.

    Attributes:
        received: Positions and when each was received, by joint; the bridge writes.
        command: Efforts, and which joints are driven; the driver, the creator, writes.
        bell: Rung by the driver when there is a command.
    """

    SEMAPHORES = ("bell",)

    @staticmethod
    def layout(n: int) -> np.dtype[np.void]:
        """Return the fields of a link of ``n`` joints.

        ``received``: positions, the wall times of the receipt (0: never) [s], and the names of the last message.
        ``command``: efforts, the driven joints, and the time of writing, monotonic clock [s].
        """
        received = np.dtype([("q", "<f8", (n,)), ("at", "<f8", (n,)), ("named", "S1024")], align=True)
        command = np.dtype([("effort", "<f8", (n,)), ("driven", "?", (n,)), ("at", "<f8")], align=True)
        return np.dtype([("received", Snapshot.layout(received)), ("command", Snapshot.layout(command))], align=True)

    def __init__(self, block: SharedBlock, dtype: np.dtype[np.void], semaphores: list[Semaphore]) -> None:
        super().__init__(block, dtype, semaphores)
        self.received = Snapshot(self.view["received"], f"{self.name}_received")
        self.command = Snapshot(self.view["command"], f"{self.name}_command")
        (self.bell,) = semaphores


class JointStateDriver:
    """Positions from one topic, efforts to another; a separate process uses ROS, since the servo has no ROS.

    While MCS wants no power, or a joint's brake, that joint is not in what is published: a robot holds a joint that has
    not been commanded for longer than it allows. Power and brakes are taken to be as wanted, as the topics do not tell.

    Args:
        instance: Which machine on this host.
        timeout_s: How long the robot may take to speak of every joint at first, wall time [s].
        joints: Names in the messages, in the order of the channels; messages may have any order, or some of them only.
        state_topic: Positions, from the robot.
        command_topic: Efforts, to the robot.
        period_s: Time between ticks [s].
        silence_s: A reading older than this, counted from its receipt, is a fault [s].

    Raises:
        ConfigError: No joints, or one named twice; a time is not positive.
        LinkError: The robot, or the process, is silent; names topic, joints and seconds.
    """

    n_grippers = 0
    n_wrenches = 0

    def __init__(
        self,
        instance: str,
        timeout_s: float,
        joints: Sequence[str],
        state_topic: str,
        command_topic: str,
        period_s: float = 0.0045,
        silence_s: float = 0.1,
    ) -> None:
        self._joints = _checked(joints)
        for name, value in (("period_s", period_s), ("silence_s", silence_s)):
            if not value > 0.0:
                raise ConfigError(f"{name} of the driver of topic '{state_topic}' is {value}, not > 0 [s]")
        self.n_joints = len(self._joints)
        self.period_s = self.wall_period_s = period_s
        self._silence_s = silence_s
        self._topic = state_topic
        self._tick = 0
        self._drive = Drive(
            np.zeros(self.n_joints), False, np.ones(self.n_joints, dtype=np.bool_), np.zeros(0), False, np.zeros(0)
        )
        name = instance + "_topics" + re.sub(r"\W", "_", state_topic)
        self._link = TopicLink.create(name, TopicLink.layout(self.n_joints))
        topics = {"state": state_topic, "command": command_topic}
        settings = {"name": name, "joints": self._joints, **topics, "silence_s": silence_s}
        self._settings = json.dumps(settings)
        self._start_bridge()
        try:
            self._wait_for_all(timeout_s)
        except LinkError:
            self.close()
            raise

    def connect(self) -> None:
        """Return whether the robot speaks; an ended process is started again.

        Raises:
            LinkError: It does not.
        """
        if self._bridge.poll() is not None and clock.monotonic() >= self._next_start:
            self._start_bridge()
        self._newest()

    def wait(self, timeout_s: float) -> bool:
        """Return at once: the next tick is there as soon as the loop has kept the pace."""
        return True

    def read(self) -> Measured:
        """Return the newest positions; NaN for a joint reported as not a number.

        Without positions no joint is driven: a bridge that wakes later finds no effort from before.

        Raises:
            LinkError: The robot, or the process, has been silent for too long; names topic, joint and seconds.
        """
        try:
            q, age_s = self._newest()
        except LinkError:
            self._command(np.zeros(self.n_joints), np.zeros(self.n_joints, dtype=np.bool_))
            raise
        braked = self._drive.brakes | (not self._drive.power)
        stamp_ns = round(self._tick * self.period_s * 1e9)
        return Measured(
            self._tick, stamp_ns, q, self._drive.power, braked, np.zeros(0), age_s, np.zeros((0, 6)), np.zeros(0)
        )

    def write(self, drive: Drive) -> None:
        """Publish the efforts of all joints with power and without brake."""
        self._drive = drive
        self._command(drive.tau, ~drive.brakes & drive.power)
        self._tick += 1

    def after_tick(self, tick: int) -> None:
        """Return at once: a topic does not report the time of reception."""

    def close(self) -> None:
        """Fall silent: the robot's time-out holds the robot."""
        self._bridge.stop()
        self._link.close()

    def _start_bridge(self) -> None:
        self._next_start = clock.monotonic() + _AGAIN_S
        self._bridge = ChildProcess.of_module(_BRIDGE, [self._settings])

    def _command(self, effort: NDArray[np.float64], driven: NDArray[np.bool_]) -> None:
        """Give the bridge efforts and the driven joints, shape (n,) each; the bridge keeps the newest only."""
        record = self._link.command.record()
        record["effort"], record["driven"], record["at"] = effort, driven, clock.monotonic()
        self._link.command.write(record)
        self._link.bell.post()

    def _newest(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and the ages, shape (n,) each."""
        received = self._link.received.read()
        age_s: NDArray[np.float64] = np.maximum(clock.monotonic() - received["at"], 0.0)
        if age_s.max() > self._silence_s:
            self._check_bridge()
            oldest = int(np.argmax(age_s))
            raise LinkError(
                f"topic '{self._topic}' has said nothing of joint '{self._joints[oldest]}' for {age_s[oldest]:.3g} s;"
                f" {self._silence_s:g} s are allowed",
                topic=self._topic,
                joint=self._joints[oldest],
                seconds=float(age_s[oldest]),
                allowed=self._silence_s,
            )
        return received["q"].copy(), age_s

    def _wait_for_all(self, timeout_s: float) -> None:
        deadline = clock.monotonic() + timeout_s
        while True:
            received = self._link.received.read()
            missing = [name for name, at in zip(self._joints, received["at"], strict=True) if at == 0.0]
            if not missing:
                return
            self._check_bridge()
            if clock.monotonic() > deadline:
                named = bytes(received["named"]).rstrip(b"\0").decode(errors="replace")
                heard = f"it names {named}" if named else "nothing was received"
                raise LinkError(
                    f"topic '{self._topic}' said nothing of joint {', '.join(missing)} within {timeout_s:g} s; {heard}",
                    topic=self._topic,
                    seconds=timeout_s,
                )
            clock.sleep(_POLL_S)

    def _check_bridge(self) -> None:
        code = self._bridge.poll()
        if code is not None:
            raise LinkError(f"the process {_BRIDGE} of topic '{self._topic}' ended with code {code}", exit_code=code)


def _checked(joints: Sequence[str]) -> tuple[str, ...]:
    names = tuple(joints)
    if not names:
        raise ConfigError("a driver of joint state topics needs the names of its joints")
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(f"joint '{twice}' is named twice")
    return names
