"""The slots: a hardware-independent view of the channels (paper, section 4)."""

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from im_core.errors import FOREIGN, ConfigError, ImError, LinkError
from im_core.processes.startup import patience_s
from im_mcs.limits.slots import Kind, Slot, Testbed
from im_mcs.testbed.driver import (
    ChannelDriver,
    CourseFollower,
    Drive,
    HostedHardware,
    Measured,
    PlannedCourse,
    SelfReporting,
    TimeKeeper,
    load_driver,
)

_COUNTS = {"joint": "n_joints", "gripper": "n_grippers", "wrench": "n_wrenches"}


Given = ParamSpec("Given")
ResultT = TypeVar("ResultT")
_Method = Callable[Concatenate["TestbedInterface", Given], ResultT]


def _guarded(method: _Method[Given, ResultT]) -> _Method[Given, ResultT]:
    """Make every failure of a driver a link error: drivers are the users', and may raise anything."""

    @wraps(method)
    def call(self: "TestbedInterface", /, *given: Given.args, **named: Given.kwargs) -> ResultT:
        try:
            return method(self, *given, **named)
        except LinkError:
            raise
        except FOREIGN as error:
            told = error.message if isinstance(error, ImError) else f"{type(error).__name__}: {error}"
            raise LinkError(f"the channel driver failed: {method.__name__}: {told}") from error

    return call


class TestbedInterface:
    """Joints, grippers and wrist sensors in the order of the slots, on any drivers and channels.

    One driver is the clock: its ticks are the servo's. The others are read and written in each of them. A driver that
    raises anything has failed, as a :class:`~im_core.errors.LinkError` says.

    Args:
        drivers: By name.
        slots: What is on their channels; a channel without a slot gets no command and keeps its brake.
        clock: Name of the driver that is the clock.

    Raises:
        ConfigError: A channel does not exist; names slot, driver, channel and what exists. Or the drivers differ in
            their period.
    """

    __test__ = False  # not a test class, whatever pytest thinks of the name

    def __init__(self, drivers: Mapping[str, ChannelDriver], slots: Sequence[Slot], clock: str) -> None:
        self._clock = drivers[clock]
        self._parts = [_Part(name, driver, slots) for name, driver in drivers.items()]
        self._single = self._parts[0].covers(slots) if len(self._parts) == 1 else False
        self._counts = {kind: sum(slot.kind == kind for slot in slots) for kind in _COUNTS}
        self.period_s = self._clock.period_s
        for name, driver in drivers.items():
            if abs(driver.period_s - self.period_s) > 1e-9:
                raise ConfigError(
                    f"driver '{name}' ticks every {driver.period_s:g} s, the clock '{clock}' every {self.period_s:g} s"
                )

    @classmethod
    def load(cls, testbed: Testbed, slots: Sequence[Slot], instance: str) -> Self:
        """Make the configured drivers of a machine, and the slots on the drivers.

        Raises:
            ConfigError: As the constructor.
            LinkError: A driver's hardware does not answer in time.
        """
        drivers = {
            name: load_driver(
                spec.driver,
                spec.settings,
                instance=instance,
                timeout_s=patience_s(),
                interfaces={s.channel: s.interface for s in slots if s.kind == "joint" and s.driver == name},
            )
            for name, spec in testbed.drivers.items()
        }
        return cls(drivers, slots, testbed.clock)

    @property
    def wall_period_s(self) -> float:
        """Wall time between ticks of the loop [s]; 0 if the clock sets the pace."""
        return self._clock.wall_period_s

    @_guarded
    def connect(self) -> None:
        """Reach all hardware.

        Raises:
            LinkError: Some does not answer.
        """
        for part in self._parts:
            part.driver.connect()

    @_guarded
    def wait(self, timeout_s: float) -> bool:
        """Wait for the next tick of the clock, at most ``timeout_s`` of wall time [s]; return whether the tick came.

        Raises:
            LinkError: The hardware is gone.
        """
        return self._clock.wait(timeout_s)

    @_guarded
    def time_asked(self) -> bool:
        """Return whether a tick must come: time passes without requests, or on request."""
        return not isinstance(self._clock, TimeKeeper) or self._clock.time_asked()

    @property
    def hardware_pid(self) -> int:
        """Process of the local host with the ticks; 0 where there is none."""
        return self._clock.hardware_pid if isinstance(self._clock, HostedHardware) else 0

    @_guarded
    def read(self) -> Measured:
        """The newest measured state, in the order of the slots.

        Power is on where every driver says so.

        Raises:
            LinkError: Hardware that has no clock of its own has fallen silent.
        """
        if self._single:
            return self._clock.read()
        n, m, w = self._counts["joint"], self._counts["gripper"], self._counts["wrench"]
        q, age_s, brakes = np.empty(n), np.empty(n), np.empty(n, dtype=np.bool_)
        gripper, gripper_force, wrench = np.empty(m), np.empty(m), np.empty((w, 6))
        power = True
        for part in self._parts:
            reading = part.driver.read()
            power = power and reading.power
            joints, channels = part.joints
            q[joints], brakes[joints] = reading.q[channels], reading.brakes[channels]
            age_s[joints] = reading.age_s[channels]
            grippers, channels = part.grippers
            gripper[grippers], gripper_force[grippers] = reading.gripper[channels], reading.gripper_force[channels]
            wrenches, channels = part.wrenches
            wrench[wrenches] = reading.wrench[channels]
            if part.driver is self._clock:
                tick, stamp_ns = reading.tick, reading.stamp_ns
        return Measured(tick, stamp_ns, q, power, brakes, gripper, age_s, wrench, gripper_force)

    @property
    def several(self) -> bool:
        """Whether there are several drivers, of which some may listen when another has failed."""
        return len(self._parts) > 1

    @_guarded
    def write(self, drive: Drive) -> None:
        """Answer the tick.

        Raises:
            LinkError: Some hardware no longer listens; all other has heard it.
        """
        if self._single:
            self._clock.write(drive)
            return
        self._each(lambda part: part.driver.write(part.drive(drive)))

    @property
    def followed(self) -> list[int]:
        """Ranks of the joints on drivers that follow courses."""
        return [rank for part in self._parts if part.follows for rank in part.joints[0].tolist()]

    @_guarded
    def speed(self) -> float:
        """Share of the wanted speed with which robots follow courses: of the slowest."""
        drivers = (part.driver for part in self._parts)
        return min((driver.speed for driver in drivers if isinstance(driver, CourseFollower)), default=1.0)

    @_guarded
    def follow(self, course: PlannedCourse) -> None:
        """Give a course to the drivers that follow one.

        Raises:
            LinkError: Some hardware no longer listens.
        """
        for part in self._parts:
            part.follow(course)

    @_guarded
    def faults(self) -> list[str]:
        """Return the faults reported by hardware, e.g. ``brake_open of elbow``.

        Raises:
            LinkError: Some does not answer.
        """
        return [fault for part in self._parts for fault in part.faults()]

    @_guarded
    def after_tick(self, tick: int) -> None:
        """Return once the hardware has taken the answer to ``tick``, where known."""
        for part in self._parts:
            part.driver.after_tick(tick)

    @_guarded
    def close(self) -> None:
        """Leave all hardware with power off and brakes on."""
        self._each(lambda part: part.driver.close())

    def _each(self, act: Callable[["_Part"], None]) -> None:
        """Act on every driver, after failures of others, too; raise the first failure then."""
        failed: list[BaseException] = []
        for part in self._parts:
            try:
                act(part)
            except FOREIGN as error:
                failed.append(error)
        if failed:
            raise failed[0]


class _Part:
    """The slots of one driver: for each kind, which slots on which channels."""

    def __init__(self, name: str, driver: ChannelDriver, slots: Sequence[Slot]) -> None:
        self.driver = driver
        self._name = name
        self.joints = self._places("joint", slots)
        self._channels = {s.channel: s.name for s in slots if s.kind == "joint" and s.driver == name}
        self.grippers = self._places("gripper", slots)
        self.wrenches = self._places("wrench", slots)

    def covers(self, slots: Sequence[Slot]) -> bool:
        """Whether slots and channels are the same, one by one: nothing need be sorted then."""
        counts = (self.driver.n_joints, self.driver.n_grippers, self.driver.n_wrenches)
        return all(
            list(places) == list(channels) == list(range(count))
            for (places, channels), count in zip((self.joints, self.grippers, self.wrenches), counts, strict=True)
        )

    def faults(self) -> list[str]:
        """Return the faults reported by the hardware, of joints with a slot and of no joint."""
        reported = self.driver.faults() if isinstance(self.driver, SelfReporting) else []
        of_none = [fault.what for fault in reported if fault.channel is None]
        of_joints = [(fault.what, self._channels.get(fault.channel)) for fault in reported if fault.channel is not None]
        return of_none + [f"{what} of {joint}" for what, joint in of_joints if joint is not None]

    @property
    def follows(self) -> bool:
        """Whether the driver follows courses."""
        return isinstance(self.driver, CourseFollower)

    def follow(self, course: PlannedCourse) -> None:
        """Give the driver its part of a course, if it follows one."""
        if isinstance(self.driver, CourseFollower):
            slots, channels = self.joints
            q = np.zeros((len(course.seconds), self.driver.n_joints))
            v = np.zeros_like(q)
            q[:, channels], v[:, channels] = course.q[:, slots], course.v[:, slots]
            self.driver.follow(PlannedCourse(course.seconds, q, v))

    def drive(self, drive: Drive) -> Drive:
        """Return the driver's part of ``drive``, in the order of the channels."""
        command = np.zeros(self.driver.n_joints)
        brakes = np.ones(self.driver.n_joints, dtype=np.bool_)
        gripper, force = np.full(self.driver.n_grippers, np.nan), np.full(self.driver.n_grippers, np.nan)
        slots, channels = self.joints
        command[channels], brakes[channels] = drive.command[slots], drive.brakes[slots]
        slots, channels = self.grippers
        gripper[channels], force[channels] = drive.gripper[slots], drive.gripper_force[slots]
        return Drive(command, drive.power, brakes, gripper, drive.wants_time, force)

    def _places(self, kind: Kind, slots: Sequence[Slot]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        count: Any = getattr(self.driver, _COUNTS[kind])
        of_kind = [slot for slot in slots if slot.kind == kind]
        mine = [(place, slot.channel) for place, slot in enumerate(of_kind) if slot.driver == self._name]
        for place, channel in mine:
            if channel >= count:
                exists = f"has 0 to {count - 1}" if count else "has none"
                raise ConfigError(
                    f"slot '{of_kind[place].name}': {kind} channel {channel} of driver '{self._name}' does not exist;"
                    f" the driver {exists}",
                    slot=of_kind[place].name,
                    driver=self._name,
                    channel=channel,
                )
        table = np.array(mine, dtype=np.intp).reshape(-1, 2)
        return table[:, 0].copy(), table[:, 1].copy()
