"""Values sent over the testbed link."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError

_LARGEST_WIDTH_M, _LARGEST_STIFFNESS_N_M, _LARGEST_MASS_KG = 1.0, 1e9, 1e3


class Sensors(NamedTuple):
    """Readings of the testbed's sensors.

    Attributes:
        q: Encoder readings, quantised and noisy, shape (n,) [rad or m].
        power: Whether the motors have power.
        brakes: Which brakes are engaged, shape (n,).
        gripper: Openings, shape (2,) [m].
        age_s: Age of each encoder reading, shape (n,) [s].
        wrench: Readings of the wrist force-torque sensors, force then torque, shape (2, 6) [N, Nm].
        gripper_force: Readings of the force between the jaws, shape (2,) [N].
    """

    q: NDArray[np.float64]
    power: bool
    brakes: NDArray[np.bool_]
    gripper: NDArray[np.float64]
    age_s: NDArray[np.float64]
    wrench: NDArray[np.float64]
    gripper_force: NDArray[np.float64]


class Measured(NamedTuple):
    """Readings of the channels at the start of a tick.

    Attributes:
        tick: Number of the tick.
        stamp_ns: Testbed time [ns].
        q: Positions, shape (n,) [rad or m].
        power: Whether the motors have power.
        brakes: Which brakes are engaged, shape (n,).
        gripper: Openings, shape (m,) [m].
        age_s: How old each position is, testbed time, shape (n,) [s]; 0 where it is of this tick.
        wrench: Wrist force-torque readings, force then torque, shape (w, 6) [N, Nm]; NaN where there is no sensor.
        gripper_force: Force between the jaws, shape (m,) [N]; NaN where it is not measured.
    """

    tick: int
    stamp_ns: int
    q: NDArray[np.float64]
    power: bool
    brakes: NDArray[np.bool_]
    gripper: NDArray[np.float64]
    age_s: NDArray[np.float64]
    wrench: NDArray[np.float64]
    gripper_force: NDArray[np.float64]


class ControlState(NamedTuple):
    """Control state of the motors.

    Attributes:
        tick: Number of the tick.
        servo: Process of the servo that takes part, 0 if none does.
        losses: How many servos were declared gone so far.
        power: Whether the motors have power.
        braked: Whether every brake is engaged.
    """

    tick: int
    servo: int
    losses: int
    power: bool
    braked: bool


class Drive(NamedTuple):
    """Commands to the channels until the next tick.

    Attributes:
        command: Torque, velocity or position of each joint, as its slot says, shape (n,)
            [Nm or N, rad/s or m/s, rad or m].
        power: Whether the motors shall have power.
        brakes: Which brakes shall be engaged, shape (n,).
        gripper: Wanted openings, shape (m,) [m].
        wants_time: Whether MCS waits for something, so that simulated time must go on.
        gripper_force: Largest force between the jaws, shape (m,) [N]; infinity stands for all the gripper can give.
    """

    command: NDArray[np.float64]
    power: bool
    brakes: NDArray[np.bool_]
    gripper: NDArray[np.float64]
    wants_time: bool
    gripper_force: NDArray[np.float64]


@dataclass(frozen=True)
class Faults:
    """Faults of the hardware.

    Attributes:
        encoder_nan: Encoders that give no number, shape (n,).
        encoder_frozen: Encoders whose reading stays what it was, while its age grows, shape (n,).
        brake_stuck: Brakes that stay engaged, shape (n,).
        brake_open: Brakes that stay open, also without power, shape (n,).
        power_loss: Whether the motors have no power, whatever is commanded.
    """

    encoder_nan: NDArray[np.bool_]
    encoder_frozen: NDArray[np.bool_]
    brake_stuck: NDArray[np.bool_]
    brake_open: NDArray[np.bool_]
    power_loss: bool

    @classmethod
    def none(cls, n_joints: int) -> "Faults":
        """Nothing is broken."""
        sound = np.zeros(n_joints, dtype=np.bool_)
        return cls(sound, sound, sound, sound, False)


@dataclass(frozen=True)
class JawObject:
    """Something between the jaws of a gripper.

    Attributes:
        width: [m].
        stiffness: [N/m].
        mass: [kg].
    """

    width: float
    stiffness: float
    mass: float

    def __post_init__(self) -> None:
        can_be = 0.0 < self.width <= _LARGEST_WIDTH_M and 0.0 < self.stiffness <= _LARGEST_STIFFNESS_N_M
        if not (can_be and 0.0 <= self.mass <= _LARGEST_MASS_KG):
            raise DataError(
                f"an object of width {self.width} m, stiffness {self.stiffness} N/m and mass {self.mass} kg cannot be:"
                f" width and stiffness are > 0, mass is >= 0; at most {_LARGEST_WIDTH_M:g} m,"
                f" {_LARGEST_STIFFNESS_N_M:g} N/m and {_LARGEST_MASS_KG:g} kg"
            )


@dataclass(frozen=True)
class LaserBeam:
    """Mirrors and power of the laser scanner: commanded, actual, or as seen by an exposure.

    Attributes:
        mirror1: Angle of mirror 1, the middle of its sweep [rad].
        mirror2: Angle of mirror 2 [rad].
        half_sweep: Mirror 1 sweeps this far to both sides, many times in an exposure; 0: it stands, the beam is a spot
            [rad].
        power: Power of the beam, 0 to 1; 0: dark.
    """

    mirror1: float = 0.0
    mirror2: float = 0.0
    half_sweep: float = 0.0
    power: float = 0.0

    def values(self) -> tuple[float, float, float, float]:
        """All four, in the order of the link."""
        return self.mirror1, self.mirror2, self.half_sweep, self.power


@dataclass(frozen=True)
class ExposureRequest:
    """A camera's wish.

    Attributes:
        request: Number of the request.
        ticks: Length of the exposure [ticks].
        blank_light: Whether the wrist lights are strobed off during it.
        blank_laser: Whether the laser is.
    """

    request: int
    ticks: int
    blank_light: bool
    blank_laser: bool = False


@dataclass(frozen=True)
class Exposure:
    """Data of one exposure.

    Attributes:
        start_tick: Tick at whose start the shutter opened.
        end_tick: Tick at whose start it closed.
        stamp_ns: Testbed time of the middle of the exposure [ns].
        q_true: True joint positions, averaged over the exposure, shape (n,) [rad or m].
        light_fraction: Fraction of the exposure during which each light was on, 0 to 1.
        laser: Where the laser's mirrors really were, and its power, averaged over the exposure.
        bodies: Poses of the free bodies at its end, those of the cell first, shape (m, 7) [m, -]; None: at the start.
        jaws: Openings of the grippers at its end, shape (grippers,) [m]; None: as at the start.
    """

    start_tick: int
    end_tick: int
    stamp_ns: int
    q_true: NDArray[np.float64]
    light_fraction: dict[str, float]
    laser: LaserBeam = LaserBeam()
    bodies: NDArray[np.float64] | None = None
    jaws: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class TrueState:
    """True state of the testbed, published by the host's end only.

    Attributes:
        q: Joint positions, shape (n,) [rad or m].
        v: Joint velocities, shape (n,) [rad/s or m/s].
    """

    q: NDArray[np.float64]
    v: NDArray[np.float64]
