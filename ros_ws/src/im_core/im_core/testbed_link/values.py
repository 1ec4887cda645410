"""What travels over the testbed link."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Slot(IntEnum):
    """Who may ask for time at clock factor 0; one writer each."""

    MCS = 0
    TESTBED = 1
    VSS = 2


@dataclass(frozen=True)
class State:
    """What the testbed's sensors say at the start of a tick.

    Attributes:
        tick: Number of the tick.
        stamp_ns: Testbed time, ``tick`` times the period [ns].
        q: Encoder readings, quantised and noisy, shape (n,) [rad or m].
        power: Whether the motors have power.
        brakes: Which brakes are engaged, shape (n,).
        gripper: Openings, shape (2,) [m].
    """

    tick: int
    stamp_ns: int
    q: NDArray[np.float64]
    power: bool
    brakes: NDArray[np.bool_]
    gripper: NDArray[np.float64]


@dataclass(frozen=True)
class Command:
    """What the servo wants during a tick.

    Attributes:
        tau: Motor torques at the joints, shape (n,) [Nm or N].
        power: Whether the motors shall have power.
        brakes: Which brakes shall be engaged, shape (n,).
        gripper: Wanted openings, shape (2,) [m].
        wants_time: Whether, at clock factor 0, another tick shall follow.
    """

    tau: NDArray[np.float64]
    power: bool
    brakes: NDArray[np.bool_]
    gripper: NDArray[np.float64]
    wants_time: bool


@dataclass(frozen=True)
class ExposureRequest:
    """A camera's wish.

    Attributes:
        request: Number of the request.
        ticks: Length of the exposure [ticks].
        blank_light: Whether the wrist lights are strobed off during it.
    """

    request: int
    ticks: int
    blank_light: bool


@dataclass(frozen=True)
class Exposure:
    """What a shutter saw.

    Attributes:
        start_tick: Tick at whose start the shutter opened.
        end_tick: Tick at whose start it closed.
        stamp_ns: Testbed time of the middle of the exposure [ns].
        q_true: True joint positions, averaged over the exposure, shape (n,) [rad or m].
        light_fraction: Fraction of the exposure during which each light was on, 0 to 1.
    """

    start_tick: int
    end_tick: int
    stamp_ns: int
    q_true: NDArray[np.float64]
    light_fraction: dict[str, float]


@dataclass(frozen=True)
class TrueState:
    """What is really so; for the testbed's own node and for tests.

    Attributes:
        q: Joint positions, shape (n,) [rad or m].
        v: Joint velocities, shape (n,) [rad/s or m/s].
        servo_losses: How often a servo was declared gone.
        servo_pid: Process of the attached servo, 0 if none.
    """

    q: NDArray[np.float64]
    v: NDArray[np.float64]
    servo_losses: int
    servo_pid: int
