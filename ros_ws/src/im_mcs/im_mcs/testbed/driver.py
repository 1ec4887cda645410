"""Contract of a channel driver: the needs of MCS from hardware, simulated or real; and optional offers of a driver."""

import inspect
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from im_cell.link.values import Drive as Drive  # parts of the contract
from im_cell.link.values import Measured as Measured
from im_mcs.limits.slots import OFFERED, Interface, check_settings, find_driver


class PlannedCourse(NamedTuple):
    """Positions of joints from now on until they rest, if nothing changes.

    Attributes:
        seconds: Times after the present command, shape (m,) [s].
        q: Positions, shape (m, n) [rad or m].
        v: Velocities, shape (m, n) [rad/s or m/s]; 0 in the end.
    """

    seconds: NDArray[np.float64]
    q: NDArray[np.float64]
    v: NDArray[np.float64]


class ChannelDriver(Protocol):
    """Hardware seen as numbered channels.

    The loop calls ``connect`` once, then in every tick ``wait``, ``read``, ``write``, in the end ``close``.
    A driver of joints that take other commands than torques names the kinds in a static ``interfaces_taken``, and
    finds the kind of each channel in the parameter ``interfaces`` of its constructor.
    """

    n_joints: int
    n_grippers: int
    n_wrenches: int
    period_s: float
    """Time between ticks [s]."""
    wall_period_s: float
    """Wall time between ticks that the loop shall keep [s]; 0 if the driver sets the pace."""

    def connect(self) -> None:
        """Reach the hardware; afterwards :meth:`read` works.

        Raises:
            LinkError: It does not answer.
        """
        ...

    def wait(self, timeout_s: float) -> bool:
        """Wait for the next tick, at most ``timeout_s`` of wall time [s]; return whether the tick came.

        Raises:
            LinkError: The hardware is gone.
        """
        ...

    def read(self) -> Measured:
        """The newest measured state."""
        ...

    def write(self, drive: Drive) -> None:
        """Answer the tick.

        Raises:
            LinkError: The hardware no longer listens to this driver.
        """
        ...

    def after_tick(self, tick: int) -> None:
        """Return once the hardware has taken the answer to ``tick``, where known."""
        ...

    def close(self) -> None:
        """Leave the hardware with power off and brakes on."""
        ...


@runtime_checkable
class TimeKeeper(Protocol):
    """Driver with time on demand, able to report whether time passes."""

    def time_asked(self) -> bool:
        """Whether somebody has asked for time beyond the present tick."""
        ...


@runtime_checkable
class CourseFollower(Protocol):
    """Driver of a robot that follows whole trajectories by itself; power and brakes are its only commands besides."""

    @property
    def speed(self) -> float:
        """Share of the wanted speed with which the robot follows now, 0 to 1."""
        ...

    def follow(self, course: PlannedCourse) -> None:
        """Follow a course from now on, in place of the one before.

        Raises:
            LinkError: The hardware no longer listens to this driver.
        """
        ...


@runtime_checkable
class HostedHardware(Protocol):
    """Driver with the hardware in a process of the local host, not silent while kept from the processor."""

    @property
    def hardware_pid(self) -> int:
        """The process."""
        ...


class ReportedFault(NamedTuple):
    """Fault reported by hardware.

    Attributes:
        what: In a word or two, e.g. ``brake_open``.
        channel: Of the joint, if it is of one.
    """

    what: str
    channel: int | None = None


@runtime_checkable
class SelfReporting(Protocol):
    """Driver with hardware-reported faults, which forbid the reset of an emergency stop."""

    def faults(self) -> Sequence[ReportedFault]:
        """Return the present faults.

        Raises:
            LinkError: The hardware does not answer.
        """
        ...


class PowerReading(NamedTuple):
    """Hardware's report of power and brakes, past the servo.

    Attributes:
        power: Whether the motors have power.
        braked: Whether every brake is engaged.
    """

    power: bool
    braked: bool

    @property
    def secured(self) -> bool:
        """Whether nothing is driven and everything is held."""
        return self.braked and not self.power


class StopCircuit(Protocol):
    """Way to the power past the servo: works with a hanging or missing servo.

    A driver that has one says so by a static method ``stop_circuit(instance: str) -> StopCircuit``.
    """

    def cut(self) -> None:
        """Cut power and engage brakes, against any command of the servo, until :meth:`restore`.

        Raises:
            LinkError: There is no hardware.
        """
        ...

    def restore(self) -> None:
        """Let the servo switch power on again.

        Raises:
            LinkError: There is no hardware.
        """
        ...

    def is_cut(self) -> bool:
        """Return whether the circuit is cut, perhaps since before the process began.

        Raises:
            LinkError: There is no hardware.
        """
        ...

    def reading(self) -> PowerReading:
        """Read power and brakes, as reported by the hardware.

        Raises:
            LinkError: There is no hardware.
        """
        ...


def find_stop_circuit(name: str, instance: str) -> StopCircuit | None:
    """Return the stop circuit of the driver ``module:Class``, if there is one.

    Raises:
        ConfigError: There is no such module or class.
    """
    make = getattr(find_driver(name), "stop_circuit", None)
    return None if make is None else cast(StopCircuit, make(instance))


def load_driver(
    name: str, settings: Mapping[str, object], *, instance: str, timeout_s: float, interfaces: Mapping[int, Interface]
) -> ChannelDriver:
    """Make the driver named ``module:Class`` in the configuration.

    Args:
        name: Of the class.
        settings: Keywords of its constructor.
        instance: Which machine on this host; given to a constructor with a parameter of that name.
        timeout_s: How long hardware may take to answer at first [s]; likewise.
        interfaces: Kinds of commands of the joints, by channel; likewise.

    Raises:
        ConfigError: There is no such module or class, or it does not take these settings.
        LinkError: The hardware does not answer.
    """
    check_settings(name, settings)
    factory = find_driver(name)
    offered = dict(zip(OFFERED, (instance, timeout_s, interfaces), strict=True))
    taken = {key: value for key, value in offered.items() if key in inspect.signature(factory).parameters}
    return cast(ChannelDriver, factory(**taken, **settings))


def asks_for_time(name: str) -> bool:
    """Return whether the driver ``module:Class`` has time on demand only: ``time_on_demand = True``.

    Raises:
        ConfigError: There is no such module or class.
    """
    return bool(getattr(find_driver(name), "time_on_demand", False))
