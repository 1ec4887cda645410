"""Channel drivers of robots on topics: ``sensor_msgs/JointState``, and the command topics of ros2_control."""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from im_core import clock
from im_core.config import Model, faults
from im_core.errors import ConfigError, LinkError
from im_core.processes.process import ChildProcess
from im_core.shm import Semaphore, SharedBlock, SharedRecord, Snapshot
from im_mcs.limits.slots import Interface
from im_mcs.testbed.driver import Drive, Measured, ReportedFault

_POLL_S, _AGAIN_S = 0.01, 1.0


class FaultTopic(Model):
    """Topic of faults of a robot, told by the robot or by its watch.

    With ``status`` it is one of ``diagnostic_msgs/DiagnosticArray``: an error, or a stale status, is a fault.
    """

    topic: str = pydantic.Field(min_length=1)
    type: str = pydantic.Field(default="std_msgs/msg/Bool", pattern=r"^\w+/msg/\w+$")
    field: str = pydantic.Field(default="data", min_length=1)
    good: tuple[bool | int | float | str, ...] = pydantic.Field(
        default=(False,), min_length=1, description="values of the field with which the robot works"
    )
    silence_s: float | None = pydantic.Field(default=None, gt=0, description="silence that is a fault, too [s]")
    status: str | None = pydantic.Field(default=None, min_length=1, description="begin of the name of a status")


class SpeedTopic(Model):
    """Topic on which a robot tells its speed scaling."""

    topic: str = pydantic.Field(min_length=1)
    type: str = pydantic.Field(default="std_msgs/msg/Float64", pattern=r"^\w+/msg/\w+$")
    field: str = pydantic.Field(default="data", min_length=1)
    full: float = pydantic.Field(default=100.0, gt=0, description="value at full speed")


class TopicLink(SharedRecord):
    """Memory between driver and bridge: received readings one way, commands for publication the other.

    Attributes:
        received: Positions and when each was taken, by joint, and faults; the bridge writes.
        command: Commands, and which joints are driven; the driver, the creator, writes.
        bell: Rung by the driver when there is a command.
        course: Newest course, where the robot follows courses; the driver writes.
    """

    SEMAPHORES = ("bell",)

    @staticmethod
    def layout(n: int, points: int = 0) -> np.dtype[np.void]:
        """Return the fields of a link of ``n`` joints, and of courses of so many points.

        ``received``: positions, when they were taken, monotonic clock (0: never) [s], the names of the last message,
        the present faults, why the bridge cannot work, and the share of full speed. ``command``: commands, the driven
        joints, and the time of writing, monotonic clock [s]. ``course``: its number, points, times [s], positions and
        velocities.
        """
        texts = [("named", "S1024"), ("faults", "S512"), ("broken", "S512")]
        received = np.dtype([("q", "<f8", (n,)), ("at", "<f8", (n,)), *texts, ("speed", "<f8")], align=True)
        command = np.dtype([("value", "<f8", (n,)), ("driven", "?", (n,)), ("at", "<f8")], align=True)
        rows = [("seconds", "<f8", (points,)), ("q", "<f8", (points, n)), ("v", "<f8", (points, n))]
        course = np.dtype([("number", "<i8"), ("count", "<i8"), *rows], align=True)
        parts = {"received": received, "command": command, "course": course}
        return np.dtype([(name, Snapshot.layout(part)) for name, part in parts.items()], align=True)

    def __init__(self, block: SharedBlock, dtype: np.dtype[np.void], semaphores: list[Semaphore]) -> None:
        super().__init__(block, dtype, semaphores)
        self.received = Snapshot(self.view["received"], f"{self.name}_received")
        self.command = Snapshot(self.view["command"], f"{self.name}_command")
        self.course = Snapshot(self.view["course"], f"{self.name}_course")
        (self.bell,) = semaphores


class JointStateDriver:
    """Positions from one topic, commands to another; a separate process uses ROS, since the servo has no ROS.

    While MCS wants no power, or a joint's brake, that joint is not driven: for a moment its velocity is 0, or its
    position the one given with the brake, or without one the last one measured; then it is not in what is published, as
    torques are not at once. A robot holds a
    joint that has not been commanded for longer than it allows. Power and brakes are taken to be as wanted, as the
    topics do not tell; but there is no power while a fault topic tells a fault. Stamps of readings are of the
    computer's clock. The robot's own stamps tell ages (:class:`~im_mcs.testbed.stamp_clock.StampClock`); the velocities
    of its messages are not read.

    Args:
        instance: Which machine on this host.
        timeout_s: How long the robot may take to speak of every joint at first, wall time [s].
        interfaces: Kinds of commands by channel.
        joints: Names in the messages, in the order of the channels; messages may have any order, or some of them only.
        state_topic: Positions, from the robot.
        command_topic: Torques, velocities and positions, to the robot.
        period_s: Time between ticks [s].
        silence_s: A reading older than this is a fault [s].
        faults: Of each fault topic, the fields of :class:`FaultTopic`.

    Raises:
        ConfigError: No joints, or one named twice; a time is not positive; a fault topic that is none.
        LinkError: The robot, or the process, is silent; names topic, joints and seconds.
    """

    n_grippers = 0
    n_wrenches = 0
    interfaces_taken: tuple[Interface, ...] = ("effort", "velocity", "position")
    bridge = "im_mcs.ros.topic_channels"
    points = 0

    def __init__(
        self,
        instance: str,
        timeout_s: float,
        interfaces: Mapping[int, Interface],
        joints: Sequence[str],
        state_topic: str,
        command_topic: str,
        period_s: float = 0.0045,
        silence_s: float = 0.1,
        faults: Sequence[Mapping[str, object]] = (),
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
        self._offset_s = clock.wall() - clock.monotonic()  # once: time that goes back would hold leases and velocities
        self._drive = Drive(
            np.zeros(self.n_joints), False, np.ones(self.n_joints, dtype=np.bool_), np.zeros(0), False, np.zeros(0)
        )
        settings: dict[str, Any] = {
            "name": instance + "_topics" + re.sub(r"\W", "_", state_topic),
            "joints": self._joints,
            "kinds": [interfaces.get(channel, "effort") for channel in range(self.n_joints)],
            "state": state_topic,
            "command": command_topic,
            "silence_s": silence_s,
            "faults": [
                checked_topic(FaultTopic, given, f"faults of the driver of topic '{state_topic}'").model_dump()
                for given in faults
            ],
            **self.encoding(interfaces),
        }
        self._settings = json.dumps(settings)
        self._link = TopicLink.create(settings["name"], TopicLink.layout(self.n_joints, self.points))
        self._start_bridge()
        try:
            self._wait_for_all(timeout_s)
        except LinkError:
            self.close()
            raise

    def encoding(self, interfaces: Mapping[int, Interface]) -> dict[str, object]:
        """Return settings of the bridge for commands of another form than joint states."""
        return {}

    def connect(self) -> None:
        """Return whether the robot speaks; an ended process is started again.

        Raises:
            LinkError: It does not.
        """
        if self._process.poll() is not None and clock.monotonic() >= self._next_start:
            self._start_bridge()
        self._newest()

    def wait(self, timeout_s: float) -> bool:
        """Return at once: the next tick is there as soon as the loop has kept the pace."""
        return True

    def read(self) -> Measured:
        """Return the newest positions; NaN for a joint reported as not a number.

        Without positions no joint is driven: a bridge that wakes later finds no command from before.

        Raises:
            LinkError: The robot, or the process, has been silent for too long; names topic, joint and seconds.
        """
        try:
            q, age_s, now = self._newest()
        except LinkError:
            self._command(np.full(self.n_joints, np.nan), np.zeros(self.n_joints, dtype=np.bool_))
            raise
        power = self._drive.power and not self._faults
        braked = self._drive.brakes | (not power)
        stamp_ns = round(1e9 * (self._offset_s + now))
        return Measured(self._tick, stamp_ns, q, power, braked, np.zeros(0), age_s, np.zeros((0, 6)), np.zeros(0))

    def write(self, drive: Drive) -> None:
        """Publish the commands of all joints with power and without brake."""
        self._drive = drive
        self._command(drive.command, ~drive.brakes & drive.power)
        self._tick += 1

    def faults(self) -> list[ReportedFault]:
        """Return the faults of the fault topics.

        Raises:
            LinkError: The robot, or the process, has been silent for too long.
        """
        self._newest()
        return [ReportedFault(self._faults)] if self._faults else []

    def after_tick(self, tick: int) -> None:
        """Return at once: a topic does not report the time of reception."""

    def close(self) -> None:
        """Fall silent, after velocities of 0 and positions as measured: the robot's time-out holds the robot."""
        self._process.stop()
        self._link.close()

    def _start_bridge(self) -> None:
        self._next_start = clock.monotonic() + _AGAIN_S
        self._process = ChildProcess.of_module(self.bridge, [self._settings])

    def _command(self, value: NDArray[np.float64], driven: NDArray[np.bool_]) -> None:
        """Give the bridge commands and the driven joints, shape (n,) each; the bridge keeps the newest only."""
        record = self._link.command.record()
        record["value"], record["driven"], record["at"] = value, driven, clock.monotonic()
        self._link.command.write(record)
        self._link.bell.post()

    def _newest(self) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Return positions and their ages, shape (n,) each, and the present time, monotonic clock [s]."""
        received, now = self._link.received.read(), clock.monotonic()
        self._faults = _text(received["faults"])
        age_s: NDArray[np.float64] = np.maximum(now - received["at"], 0.0)
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
        return received["q"].copy(), age_s, now

    def _wait_for_all(self, timeout_s: float) -> None:
        deadline = clock.monotonic() + timeout_s
        while True:
            received = self._link.received.read()
            missing = [name for name, at in zip(self._joints, received["at"], strict=True) if at == 0.0]
            if not missing:
                return
            self._check_bridge()
            if clock.monotonic() > deadline:
                named = _text(received["named"])
                heard = f"it names {named}" if named else "nothing was received"
                raise LinkError(
                    f"topic '{self._topic}' said nothing of joint {', '.join(missing)} within {timeout_s:g} s; {heard}",
                    topic=self._topic,
                    seconds=timeout_s,
                )
            clock.sleep(_POLL_S)

    def _check_bridge(self) -> None:
        code = self._process.poll()
        if code is not None:
            why = _text(self._link.received.read()["broken"])
            ended = f"the process {self.bridge} of topic '{self._topic}' ended with code {code}"
            raise LinkError(f"{ended}: {why}" if why else ended, exit_code=code)


class CommandTopicDriver(JointStateDriver):
    """Positions from ``sensor_msgs/JointState``, commands to a ``forward_command_controller`` of ros2_control.

    The controller takes ``std_msgs/Float64MultiArray``: a number for each of its joints, all of one kind. It ignores a
    message of another size, and keeps the last command for as long as none comes. So a joint that is not driven while
    others are gets no torque, no velocity, or the position where it was last measured.

    Args:
        instance: Which machine on this host.
        timeout_s: As of :class:`JointStateDriver`.
        interfaces: Kinds of commands by channel.
        joints: Names in the joint states, in the order of the channels.
        state_topic: Positions, from the robot.
        command_topic: Commands, e.g. ``/forward_position_controller/commands``.
        command_joints: The parameter ``joints`` of the controller, in its order; ``joints`` if not given.
        period_s: Time between ticks [s].
        silence_s: A reading older than this is a fault [s].
        faults: As of :class:`JointStateDriver`.

    Raises:
        ConfigError: As of :class:`JointStateDriver`; or the joints of the controller are others, or of several kinds.
        LinkError: The robot, or the process, is silent; names topic, joints and seconds.
    """

    def __init__(
        self,
        instance: str,
        timeout_s: float,
        interfaces: Mapping[int, Interface],
        joints: Sequence[str],
        state_topic: str,
        command_topic: str,
        command_joints: Sequence[str] | None = None,
        period_s: float = 0.0045,
        silence_s: float = 0.1,
        faults: Sequence[Mapping[str, object]] = (),
    ) -> None:
        self._order = _checked(joints if command_joints is None else command_joints)
        self._command_topic = command_topic
        super().__init__(
            instance, timeout_s, interfaces, joints, state_topic, command_topic, period_s, silence_s, faults
        )

    def encoding(self, interfaces: Mapping[int, Interface]) -> dict[str, object]:
        """Return the joints of the controller, in its order.

        Raises:
            ConfigError: They are not those of the driver, or of several kinds, or one has no slot.
        """
        told = f"the driver of topic '{self._command_topic}'"
        if sorted(self._order) != sorted(self._joints):
            raise ConfigError(
                f"command_joints of {told} are {', '.join(self._order)}; they must be the joints "
                f"{', '.join(self._joints)}, in the order of the controller"
            )
        without = [joint for channel, joint in enumerate(self._joints) if channel not in interfaces]
        if without:
            raise ConfigError(f"{told} commands all of its joints, and {', '.join(without)} has no slot")
        kinds = sorted(set(interfaces.values()))
        if len(kinds) > 1:
            raise ConfigError(f"slots of {told} take {' and '.join(kinds)}; a controller gives one of them")
        return {"order": self._order}


def _checked(joints: Sequence[str]) -> tuple[str, ...]:
    names = tuple(joints)
    if not names:
        raise ConfigError("a driver of joint state topics needs the names of its joints")
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(f"joint '{twice}' is named twice")
    return names


TopicT = TypeVar("TopicT", FaultTopic, SpeedTopic)


def checked_topic(model: type[TopicT], given: Mapping[str, object], where: str) -> TopicT:
    """Return settings of a topic as the typed model.

    Raises:
        ConfigError: They are none; says where.
    """
    try:
        return model.model_validate(given)
    except pydantic.ValidationError as error:
        told = "; ".join(f"{fault.field}: {fault.sentence}" for fault in faults(error, model))
        raise ConfigError(f"{where}: {told}") from None


def _text(value: Any) -> str:
    return bytes(value).rstrip(b"\0").decode(errors="replace")
